"""Roll-outs at scale: vectorised environments, demonstrations and roll-outs of a policy.

All of bgr in `sim_two_arms`, in worker processes, without ROS. `--weights` are those of
`./surg learn bgr --cameras`. `--json FILE` writes:

    format          "surg_bench_rollouts/1"
    machine         {processor, cores, load_before, load_after, date}
    vectors         [{workers, pictures (640x480, left), copy (by the parent too), steps_per_s,
                    cpu_ms_per_step (of workers and parent)}]: gymnasium's AsyncVectorEnv with
                    shared memory; a step is 50 ms simulated
    looks           {put_on, picture, picture_plain} CPU time of a drawn look [ms]: to put it on,
                    and of a picture 640x480 with it and without
    episodes        [{what, workers, episodes, wall_s, per_hour}]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bench_imitation
import gymnasium
import numpy as np
from machine import this_machine

from surg_cli.host.terminal import Progress, say, table
from surg_core.contract import GRID_RATE
from surg_recording.job_pool import Executor, JobCallbacks
from surg_recording.job_pool import run as run_jobs
from surg_sim.appearance.domain_randomization import DomainRandomization
from surg_sim.appearance.endoscope_renderer import EndoscopeRenderer
from surg_sim.envs import demonstrations
from surg_sim.envs.surg_env import SurgEnv
from surg_sim.physics import cell_files
from surg_sim.tasks import episode_seeds

CELL, TASK, SIZE = "sim_two_arms", "bgr", (640, 480)
CONDITION = "as trained"


def cpu_of(pids: list[int]) -> float:
    """CPU time of these processes so far [s]."""
    ticks = 0
    for pid in pids:
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
        ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def vector(workers: int, pictures: bool, copy: bool, steps: int) -> dict[str, Any]:
    """Steps of environments whose arms hold still, after a second for everything to settle."""
    width, height = SIZE
    seen = {"images": ("left",), "width": width, "height": height} if pictures else {}
    env = gymnasium.make_vec(
        f"surg_sim/{TASK}-v0",
        num_envs=workers,
        vectorization_mode="async",
        vector_kwargs={"shared_memory": True, "copy": copy},
        cell=CELL,
        **seen,
    )
    try:
        state = env.reset(seed=list(range(workers)))[0]["state"]
        hold = np.column_stack([state[:, 5:9], state[:, 4]])
        for _ in range(GRID_RATE):
            env.step(hold)
        pids = [os.getpid(), *(process.pid for process in env.unwrapped.processes)]
        wall, cpu = time.perf_counter(), cpu_of(pids)
        for _ in range(steps):
            env.step(hold)
        wall, cpu = time.perf_counter() - wall, cpu_of(pids) - cpu
    finally:
        env.close()
    count = workers * steps
    return {
        "workers": workers,
        "pictures": pictures,
        "copy": copy,
        "steps_per_s": count / wall,
        "cpu_ms_per_step": 1e3 * cpu / count,
    }


def looks(pictures: int = 40) -> dict[str, float]:
    """What a drawn look costs at reset and in each picture."""
    width, height = SIZE
    env = SurgEnv(TASK, CELL, images=("left",), width=width, height=height)
    world = env.session.world
    eye = EndoscopeRenderer(world, ("left",), width, height)
    drawn = DomainRandomization().draw(3)

    def cost(work: Callable[[], Any], count: int) -> float:
        work()
        begun = time.process_time()
        for _ in range(count):
            work()
        return 1e3 * (time.process_time() - begun) / count

    plain = cost(lambda: eye.render(world.data.qpos), pictures)
    put_on = cost(lambda: eye.set_appearance(drawn), pictures // 4)
    worn = cost(lambda: eye.render(world.data.qpos), pictures)
    eye.close()
    return {"put_on": put_on, "picture": worn, "picture_plain": plain}


def timed(what: str, workers: int, play: Callable[[], int]) -> dict[str, Any]:
    """Episodes per hour of something that returns how many it has played."""
    begun = time.perf_counter()
    count = play()
    wall = time.perf_counter() - begun
    hourly = 3600.0 * count / wall
    return {
        "what": what,
        "workers": workers,
        "episodes": count,
        "wall_s": wall,
        "per_hour": hourly,
    }


def demonstrate(episodes: int, cameras: tuple[str, ...], workers: int) -> int:
    """Record demonstrations of the scripted expert."""
    with tempfile.TemporaryDirectory() as folder:
        plan = demonstrations.DemonstrationPlan(
            Path(folder), cell_files.find(CELL), TASK, cameras=cameras
        )
        return len(demonstrations.play(plan, episode_seeds.training_seeds(episodes), workers))


def roll_out(episodes: int, weights: Path, workers: int) -> int:
    """Play the image policy, each roll-out in a scene of its own."""
    seeds = episode_seeds.test_seeds(episodes)
    jobs = {str(seed): (CONDITION, seed, weights.absolute()) for seed in seeds}
    played: list[int] = []

    def lost(seed: str, why: str) -> None:
        raise SystemExit(f"bench rollouts: seed {seed}: {why}")

    ends = JobCallbacks(lambda _, result: played.append(result.seed), lost)
    run_jobs(bench_imitation.judge, jobs, Executor("process", workers), ends)
    return len(played)


def shown(row: dict[str, Any]) -> list[str]:
    """A row of a table."""
    return [f"{value:.4g}" if type(value) is float else str(value) for value in row.values()]


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(
        prog="bench rollouts", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--steps", type=int, default=100, help="of each vectorised environment")
    parser.add_argument("--episodes", type=int, default=8, help="of each kind; 0: none")
    parser.add_argument("--weights", type=Path, help="of learn bgr --cameras: roll-outs of it too")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    options = parser.parse_args()
    before, n, workers = os.getloadavg()[0], options.episodes, options.workers
    cases = [
        (w, p, c) for w in (1, workers) for p, c in ((False, True), (True, True), (True, False))
    ]
    kinds: list[tuple[str, Callable[[], int]]] = []
    if n:
        for cameras in ((), ("left",)):
            what = f"demonstrations{', left picture' if cameras else ''}"
            kinds.append((what, lambda cameras=cameras: demonstrate(n, cameras, workers)))
        if options.weights:
            kinds.append(("roll-outs, image policy", lambda: roll_out(n, options.weights, workers)))
    found: dict[str, Any] = {"format": "surg_bench_rollouts/1", "vectors": [], "episodes": []}
    with Progress("bench rollouts") as progress:
        for i, case in enumerate(cases):
            progress.update(i / (len(cases) + len(kinds)), "vectorised environments")
            found["vectors"].append(vector(*case, options.steps))
        found["looks"] = looks()
        for i, (what, play) in enumerate(kinds):
            progress.update((len(cases) + i) / (len(cases) + len(kinds)), what)
            found["episodes"].append(timed(what, workers, play))
    found["machine"] = this_machine(before)
    for rows in (found["vectors"], found["episodes"]):
        if rows:
            say(table([list(rows[0]), *(shown(row) for row in rows)]))
    costs = ", ".join(f"{name} {ms:.1f}" for name, ms in found["looks"].items())
    say(f"CPU time of a drawn look [ms]: {costs}")
    say(f"load {before:.1f} before, {found['machine']['load_after']:.1f} after")
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
