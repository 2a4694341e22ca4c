"""The phantom's speed: bgr in process, through the ROS graph with a view, and stereo pictures.

`--json FILE` writes (all are ratios or rates of this machine, now):

    format                          "surg_bench_sim/1"
    machine                         {processor, cores, load_before, load_after, date}
    real_time_factor_in_process     simulated by wall time: both arms, controllers, senders; no
                                    pictures
    real_time_factor_in_process_cpu the same by CPU time, which other work disturbs less
    real_time_factor_ros_one_view   through ROS in lock-step, one 640x480 view at 20 fps, recorded;
                                    absent with --no-ros
    stereo_640x480_pairs_per_s      pairs of the endoscope with the bowel drawn
    stereo_640x480_pairs_per_cpu_s  the same by CPU time of the process
    step_us                         {mujoco, controllers, rest}: of one tick of 2 ms, median
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from machine import this_machine

from surg_cli.host import paths
from surg_cli.host.terminal import Progress, say, table
from surg_sim.envs.cell_session import CellSession
from surg_sim.envs.episode_runner import run_episode
from surg_sim.physics import cell_files
from surg_sim.tasks import episode_seeds

sys.path.insert(0, str(paths.ROOT / "tests"))
from helpers.sim.render_speed import stereo_speed

CELL, TASK = "sim_two_arms", "bgr"


def in_process(episodes: int) -> dict[str, float]:
    """Episodes one after another in one compiled scene."""
    session = CellSession(cell_files.find(CELL), TASK)
    simulated = 0.0
    wall, cpu = time.perf_counter(), time.process_time()
    for seed in episode_seeds.test_seeds(episodes):
        simulated += run_episode(session, seed).duration
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return {
        "real_time_factor_in_process": simulated / wall,
        "real_time_factor_in_process_cpu": simulated / cpu,
    }


def parts(ticks: int = 1500) -> dict[str, float]:
    """Where a tick's time goes [us]."""
    import mujoco

    session = CellSession(cell_files.find(CELL), TASK)
    whole, physics, control = [], [], []
    for _ in range(ticks):
        start = time.perf_counter_ns()
        session.tick()
        whole.append(time.perf_counter_ns() - start)
    model, data = session.world.model, session.world.data
    measured = {name: session.world.state(name) for name in session.controllers}
    for _ in range(ticks):
        start = time.perf_counter_ns()
        mujoco.mj_step(model, data, 2)
        physics.append(time.perf_counter_ns() - start)
        start = time.perf_counter_ns()
        for name, controller in session.controllers.items():
            controller.step(measured[name].q, measured[name].qd)
        control.append(time.perf_counter_ns() - start)
    values = [statistics.median(part) / 1e3 for part in (whole, physics, control)]
    return {"mujoco": values[1], "controllers": values[2], "rest": values[0] - sum(values[1:])}


def stereo(pairs: int) -> dict[str, float]:
    """Pairs of 640x480 of a scene that moves."""
    world = CellSession(cell_files.find(CELL), TASK, visuals=True).world
    speed = stereo_speed(world, pairs=pairs)
    return {
        "stereo_640x480_pairs_per_s": speed.pairs_per_s,
        "stereo_640x480_pairs_per_cpu_s": 1.0 / speed.cpu_s_per_pair,
    }


def through_ros() -> dict[str, float]:
    """One recorded episode with one view."""
    from real_time_factor import real_time_factor

    with tempfile.TemporaryDirectory() as folder:
        factor = real_time_factor(TASK, "ur5e", episode_seeds.TEST.start, Path(folder), "left")
    return {"real_time_factor_ros_one_view": factor}


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="bench sim", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--episodes", type=int, default=5, help="in process")
    parser.add_argument("--pairs", type=int, default=60, help="stereo pictures")
    parser.add_argument("--no-ros", action="store_true", help="leave the ROS graph out")
    options = parser.parse_args()
    before = os.getloadavg()[0]
    found: dict[str, Any] = {"format": "surg_bench_sim/1"}
    steps = [lambda: in_process(options.episodes), lambda: stereo(options.pairs)]
    if not options.no_ros:
        steps.append(through_ros)
    with Progress("bench sim") as progress:
        for i, step in enumerate(steps):
            progress.update(i / len(steps))
            found.update(step())
    found["step_us"] = parts()
    found["machine"] = this_machine(before)
    rows = [[name, f"{value:.2f}"] for name, value in found.items() if isinstance(value, float)]
    rows += [[f"tick: {name} [us]", f"{value:.0f}"] for name, value in found["step_us"].items()]
    say(table(rows))
    if options.json:
        options.json.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
