"""Follows a run of the graph: waits until it is up, notices why it must end, ends its recording."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from typing import NoReturn

from surg_cli.graph import processes, running, system
from surg_cli.graph.system_plan import RECORDER
from surg_cli.graph.watch import Watch
from surg_cli.host.terminal import CliError, say, warn

START_TIMEOUT_S = 60.0
LOOK_S = 0.05
STALL_TIMEOUT_S = 30.0
FIRST_TICK_TIMEOUT_S = system.CAMERA_START_S + 15.0
"""The simulator waits for everybody, gives up itself before that, and names who is missing."""
RECORDER_TIMEOUT_S = 120.0
STATUS_TIMEOUT_S = 5.0
"""The status comes on a connection of its own, perhaps after the flag."""


def failure(
    watch: Watch,
    supervisor: processes.Supervisor,
    may_end: Collection[str] = (),
    simulates: bool = True,
) -> list[str]:
    """Why a run must end now, beside an arm in FAULT; empty while all is well.

    Nodes in ``may_end`` may end with exit status 0 while the run goes on. ``simulates``: the
    simulator is part of the run.
    """
    sim = watch.sim
    if sim.state == sim.STATE_ABORTED:
        return [f"the simulator aborted: {sim.detail}"]
    if sim.state == sim.STATE_DONE:
        return []
    dead = supervisor.first_dead()
    if dead is not None and not (dead.name in may_end and dead.exit_code == 0):
        return [death_notice(dead)]
    limit = FIRST_TICK_TIMEOUT_S if sim.tick == 1 else STALL_TIMEOUT_S
    if watch.stalled_s <= limit or not simulates:
        return []
    if not sim.state:
        return [f"the simulator's status is missing: {watch.problem('/sim/status')}"]
    return [f"the simulator has stood still for {limit:.0f} s at tick {sim.tick}"]


def finish_recording(watch: Watch, supervisor: processes.Supervisor) -> list[str]:
    """Stop the recorder and wait for its files; say what is wrong with them."""
    recorder = next(c for c in supervisor.children if c.name == f"/{RECORDER}")
    watch.record(False)
    ended = processes.wait_until(
        lambda: watch.recording is False or recorder.exit_code is not None, RECORDER_TIMEOUT_S
    )
    if not ended or watch.recording is not False:
        return ["the recorder did not finish its files"]
    processes.wait_until(lambda: recorder_idle(watch), STATUS_TIMEOUT_S)
    status = watch.record_status
    if not recorder_idle(watch):
        problem = watch.problem("/record/status") or "the recorder is not idle"
        return [f"nobody knows whether the recording is complete: {problem}"]
    if status.problem != status.PROBLEM_NONE:
        return [f"the recording is incomplete: {status.detail}"]
    return []


def recorder_idle(watch: Watch) -> bool:
    """Whether the recorder states, in a valid and fresh message, that it is idle."""
    status = watch.record_status
    return bool(status.state == status.STATE_IDLE)


def death_notice(child: processes.Child) -> str:
    """What to say of a node that has ended: its name, status, last words, and a cure if known."""
    code = child.exit_code
    how = f"was killed by signal {-code}" if code is not None and code < 0 else f"ended ({code})"
    tail = child.log_tail()
    text = f"node {child.name} {how}; the end of {child.log}:\n{tail}"
    lowered = tail.lower()
    graphics = ("libegl", "libosmesa", "libopengl", "gladloadgl", "eglerror", "opengl platform")
    if any(word in lowered for word in graphics):
        text += (
            "\nA library for off-screen rendering is missing or does not work: "
            "run ./surg dev setup, try MUJOCO_GL=osmesa ./surg demo, or leave the camera out "
            "(demo: --no-video; run: without --cameras)."
        )
    return text


def raise_if_dead(supervisor: processes.Supervisor) -> None:
    """Check that all essential nodes run.

    Raises:
        CliError: One has ended, with its exit status if that is 2 (wrong input).
    """
    dead = supervisor.first_dead()
    if dead is not None:
        raise CliError(death_notice(dead), 2 if dead.exit_code == 2 else 1)


def raise_if_failed(watch: Watch, supervisor: processes.Supervisor) -> None:
    """Check that all essential nodes run and that the simulator has not aborted."""
    raise_if_dead(supervisor)
    sim = watch.sim
    if sim.state == sim.STATE_ABORTED:
        raise CliError(f"the simulator aborted: {sim.detail}")


def pass_on_news(watch: Watch, entry: running.System | None) -> None:
    """Print new errors and warnings of the arms, and list the errors for `./surg status`."""
    news = watch.news()
    for origin, text in news:
        say(f"{origin}: {text}")
        arm, _, kind = origin.partition(" ")
        if entry is not None and kind == "error":
            entry.last_errors[arm] = text
    if entry is not None and news:
        entry.save()


def warn_of_ended(supervisor: processes.Supervisor, told: set[str]) -> None:
    """Print once for each node that may end that it has failed; ``told`` holds their names."""
    for child in supervisor.children:
        if child.name not in told and (text := failed_alone(child)):
            told.add(child.name)
            warn(text)


def failed_alone(child: processes.Child) -> str:
    """What to say of a node that may end and has failed; empty: it has not."""
    if child.essential or child.exit_code in (None, 0):
        return ""
    return f"{child.name} ended ({child.exit_code}), the rest runs on: {child.log_tail(1)}"


def keep(watch: Watch, supervisor: processes.Supervisor, entry: running.System | None) -> NoReturn:
    """Stay until a signal arrives or a node dies; print what the arms report."""
    told: set[str] = set()
    while True:
        time.sleep(0.1)
        raise_if_failed(watch, supervisor)
        warn_of_ended(supervisor, told)
        pass_on_news(watch, entry)


def wait_for(
    missing: Callable[[], Sequence[str]],
    supervisor: processes.Supervisor,
    progress: Callable[[float | None, str], None],
    timeout_s: float = START_TIMEOUT_S,
) -> None:
    """Wait while the system starts, until nothing is missing.

    Raises:
        CliError: A node has ended (its exit code is kept), or the time is over: names what is
            missing.
    """
    deadline = time.monotonic() + timeout_s
    while names := ", ".join(missing()):
        raise_if_dead(supervisor)
        if time.monotonic() > deadline:
            raise CliError(f"waited {timeout_s:.0f} s for {names}; see {supervisor.logs}")
        progress(None, f"waiting for {names}")
        time.sleep(LOOK_S)


def start_recording(
    watch: Watch,
    supervisor: processes.Supervisor,
    progress: Callable[[float | None, str], None],
) -> None:
    """Start the recorder and wait until it records."""
    watch.record(True)
    wait_for(lambda: [] if watch.recording else ["the recorder"], supervisor, progress)
