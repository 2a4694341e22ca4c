"""Follows a run of the graph: waits until it is up, notices why it must end, ends its recording."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection

from surg_cli.graph import processes, running, system
from surg_cli.graph.watch import Watch
from surg_cli.host.terminal import Problem, say

START_TIMEOUT_S = 60.0
STALL_TIMEOUT_S = 30.0
FIRST_TICK_TIMEOUT_S = system.CAMERA_START_S + 15.0
"""The simulator waits for everybody, gives up itself before that, and names who is missing."""
RECORDER_TIMEOUT_S = 120.0
FAULT_GRACE_S = 1.0
STATUS_TIMEOUT_S = 5.0
"""The status comes on a connection of its own, perhaps after the flag."""


def failure(
    watch: Watch,
    supervisor: processes.Supervisor,
    fault_at: float | None,
    may_end: Collection[str] = (),
) -> list[str]:
    """Why a run must end now.

    Args:
        watch: What the system says.
        supervisor: Its processes.
        fault_at: Steady clock [s] when the first FAULT was seen; it gets time to explain itself.
        may_end: Names of nodes that may end by themselves, well, while the run goes on.

    Returns:
        Sentences; empty while all is well.
    """
    sim = watch.sim
    if sim.state == sim.STATE_ABORTED:
        return [f"the simulator aborted: {sim.detail}"]
    if sim.state == sim.STATE_DONE:
        return []
    dead = supervisor.first_dead()
    if dead is not None and not (dead.name in may_end and dead.exit_code == 0):
        return [death_notice(dead)]
    if fault_at is not None and time.monotonic() - fault_at > FAULT_GRACE_S:
        arm = watch.faulted[0]
        return [f"{arm} went into FAULT: {watch.last_error(arm) or 'it gave no reason'}"]
    tick = sim.tick
    limit = FIRST_TICK_TIMEOUT_S if tick == 1 else STALL_TIMEOUT_S
    if watch.stalled_s > limit and not sim.state:
        return [f"the simulator's status is missing: {watch.problem('/sim/status')}"]
    if watch.stalled_s > limit:
        return [f"the simulator has stood still for {limit:.0f} s at tick {tick}"]
    return []


def finish_recording(watch: Watch, supervisor: processes.Supervisor) -> list[str]:
    """Stop the recorder and wait for its files; say what is wrong with them."""
    recorder = next(c for c in supervisor.children if c.name == f"/{system.RECORDER}")
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
            "\nA library for off-screen rendering is missing or does not work: run ./surg setup, "
            "try MUJOCO_GL=osmesa ./surg demo, or leave the camera out (demo: --no-video; run: "
            "without --cameras)."
        )
    return text


def raise_if_dead(supervisor: processes.Supervisor) -> None:
    """Check that all essential nodes run.

    Raises:
        Problem: One has ended, with its exit status if that is 2 (wrong input).
    """
    dead = supervisor.first_dead()
    if dead is not None:
        raise Problem(death_notice(dead), 2 if dead.exit_code == 2 else 1)


def raise_if_failed(watch: Watch, supervisor: processes.Supervisor) -> None:
    """Check that all essential nodes run and the simulator has not aborted.

    Raises:
        Problem: One has ended, or the simulator names the reason why it aborted.
    """
    raise_if_dead(supervisor)
    sim = watch.sim
    if sim.state == sim.STATE_ABORTED:
        raise Problem(f"the simulator aborted: {sim.detail}")


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


def wait_for(
    condition: Callable[[], bool],
    supervisor: processes.Supervisor,
    progress: Callable[[float, str], None],
    what: str,
) -> None:
    """Wait for a condition while the system starts.

    Args:
        condition: Becomes true.
        supervisor: Of the starting processes.
        progress: Told what is waited for.
        what: In words.

    Raises:
        Problem: When a node ends meanwhile (its exit code is kept), or after a minute.
    """
    deadline = time.monotonic() + START_TIMEOUT_S
    while not condition():
        raise_if_dead(supervisor)
        if time.monotonic() > deadline:
            raise Problem(f"waited {START_TIMEOUT_S:.0f} s for {what}; see {supervisor.logs}")
        progress(0.0, f"waiting for {what}")
        time.sleep(0.02)
