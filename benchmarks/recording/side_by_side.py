"""The recorder and `rosbag record` on one running system: the same messages, the same seconds."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from surg_cli.graph import episode_plans, master, processes, system
from surg_cli.graph.watch import Watch
from surg_cli.host import cells, environment
from surg_cli.host.terminal import CliError

ROSBAG = Path("/usr/lib/rosbag/record")
WARM_UP_S = 3.0
START_S = 60.0
CAMERAS_S = 300.0
_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Taken:
    """What a recorder has used up to a moment: CPU time [s] by process, size of its files."""

    wall: float
    cpu: dict[int, float]
    size: int


def measure(task: str, robot: str, views: str, seconds: float, out: Path) -> dict[str, Any]:
    """Play a task in free-run, recorded twice.

    Args:
        task: Its name.
        robot: As for `./surg run --robot`.
        views: As for `./surg run --cameras`.
        seconds: Measured wall-clock time.
        out: New folder.

    Raises:
        CliError: The system does not come up, or rosbag is not there.
    """
    if not ROSBAG.exists():
        raise CliError(f"{ROSBAG} is missing: ./surg dev setup installs python3-rosbag")
    out.mkdir(parents=True)
    condition = episode_plans.Condition("phantom", "ours")
    cell = episode_plans.find_cell(robot)
    plan = episode_plans.make_plan(
        task, cell, cells.load(cell), [condition], 0, episode_plans.VIEWS[views], out
    )
    plan = replace(episode_plans.for_episode(plan, condition, 0, out), lockstep=False)
    env = environment.for_nodes(ros_home=out / "logs" / "ros")
    with processes.orphans_adopted(), processes.Supervisor(env, out / "logs") as supervisor:
        master.start(supervisor, master.free_port())
        for node in system.nodes(plan):
            system.start(supervisor, node)
        os.environ.update(supervisor.env)
        with Watch(plan.arms) as watch:
            return _measure(plan, supervisor, watch, seconds)


def topics(plan: system.SystemPlan) -> list[str]:
    """What both record: all that the recorder makes rows and videos of."""
    per_arm = ("cycle", "servo_cp", "servo_jp", "jaw/servo_jp", "operating_state", "error")
    found = [f"/{arm}/{name}" for arm in plan.arms for name in per_arm]
    found += ["/sim/ground_truth/state", "/sim/task_state"]
    return found + [f"/endoscope/{view}/image_raw" for view in plan.cameras]


def _measure(
    plan: system.SystemPlan, supervisor: processes.Supervisor, watch: Watch, seconds: float
) -> dict[str, Any]:
    def up() -> bool:
        dead = supervisor.first_dead()
        if dead is not None:
            raise CliError(f"{dead.name} ended:\n{dead.log_tail()}")
        return set(plan.arms) <= set(watch.states) and watch.recording is not None

    if not processes.wait_until(up, START_S):
        raise CliError(f"the system did not come up within {START_S:g} s")
    bag_file = plan.out / "all.bag"
    bag = supervisor.start(
        "/rosbag", [ROSBAG, "-O", bag_file, *topics(plan), "__name:=rosbag"], essential=False
    )
    for node in system.senders(plan):
        system.start(supervisor, replace(node, essential=False))
    watch.record(True)
    if not processes.wait_until(lambda: watch.recording is True, START_S):
        raise CliError("the recorder did not start")
    recorder = next(c for c in supervisor.children if c.name == "/recorder").process.pid
    processes.wait_until(lambda: bool(watch.record_status.folder), START_S)
    folder = Path(f"{watch.record_status.folder}.partial")
    if not processes.wait_until(lambda: _all_cameras(watch, plan), CAMERAS_S):
        raise CliError(f"the cameras sent nothing within {CAMERAS_S:g} s")
    time.sleep(WARM_UP_S)
    begun = _taken(recorder, folder), _taken(bag.process.pid, plan.out)
    time.sleep(seconds)
    ended = _taken(recorder, folder), _taken(bag.process.pid, plan.out)
    watch.record(False)
    processes.wait_until(lambda: watch.recording is False, START_S)
    processes.wait_until(lambda: bool(watch.record_status.finished), START_S)
    finished = Path(watch.record_status.finished)
    bag.send(signal.SIGINT)
    processes.wait_until(lambda: bag.exit_code is not None, START_S)
    ours, theirs = _difference(begun[0], ended[0]), _difference(begun[1], ended[1])
    own = ended[0].cpu[recorder] - begun[0].cpu[recorder]
    ours.update(node_cpu_s=own, encoders_cpu_s=ours["cpu_s"] - own)
    return {
        "seconds": ended[0].wall - begun[0].wall,
        "recorder": ours,
        "rosbag": theirs,
        **_contents(finished, bag_file, plan),
    }


def _all_cameras(watch: Watch, plan: system.SystemPlan) -> bool:
    received = {stream.name: stream.received for stream in watch.record_status.streams}
    return all(received.get(name, 0) > 0 for name in plan.streams)


def _taken(pid: int, folder: Path) -> Taken:
    """What a process and its children have used, and what lies in its folder (not below it)."""
    family = [pid, *_children(pid)]
    size = sum(f.stat().st_size for f in folder.iterdir() if f.is_file())
    return Taken(time.monotonic(), {p: _cpu(p) for p in family}, size)


def _children(pid: int) -> list[int]:
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(word) for task in tasks for word in task.read_text().split()]


def _cpu(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) * _TICK_S


def _difference(begun: Taken, ended: Taken) -> dict[str, float]:
    wall = ended.wall - begun.wall
    cpu = sum(value - begun.cpu.get(pid, 0.0) for pid, value in ended.cpu.items())
    grown = (ended.size - begun.size) / 1e6
    return {
        "cpu_s": cpu,
        "cpu_percent": 100.0 * cpu / wall,
        "mb_per_min": grown / wall * 60.0,
    }


def _contents(finished: Path, bag_file: Path, plan: system.SystemPlan) -> dict[str, Any]:
    """How many messages of each topic both hold."""
    import rosbag

    from surg_recording.episode import episode_reader

    recorded = episode_reader.read(finished)
    with rosbag.Bag(str(bag_file)) as bag:
        counts = {t: e.message_count for t, e in bag.get_type_and_topic_info().topics.items()}
    tables, videos = recorded.manifest["tables"], recorded.manifest["videos"]
    rows = {f"/{arm}/cycle": tables.get(f"cycle_{arm}", {}) for arm in plan.arms}
    messages = {
        topic: {"rows": entry.get("rows", 0), "rosbag": counts.get(topic, 0)}
        for topic, entry in rows.items()
    }
    for view in plan.cameras:
        topic = f"/endoscope/{view}/image_raw"
        frames = videos.get(f"endoscope_{view}", {}).get("frames", 0)
        messages[topic] = {"rows": frames, "rosbag": counts.get(topic, 0)}
    dropped = {n: e["dropped"] for n, e in {**tables, **videos}.items()}
    return {
        "messages": messages,
        "drops": {name: count for name, count in dropped.items() if count},
        "cycle_drops": sum(dropped.get(f"cycle_{arm}", 0) for arm in plan.arms),
        "missing_ticks": sum(entry.get("missing_ticks") or 0 for entry in rows.values()),
        "repeats": recorded.manifest.get("repeats"),
        "reason": recorded.manifest["reason"],
    }
