"""Roll-outs in other processes and on Dask: each ends once, as in this process."""

from __future__ import annotations

import importlib.util
import os
import signal
import threading
import time
from pathlib import Path

import pytest

from surg_recording import job_pool
from surg_recording.job_pool import Executor, JobCallbacks

pytest.importorskip("gymnasium", reason="gymnasium is not installed: ./surg dev setup")
from helpers.sim import short_rollouts
from helpers.sim.short_rollouts import Job, Result

SEEDS = range(6)
dask_is_there = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None, reason="python3-distributed is not installed"
)


def jobs_in(folder: Path) -> list[Job]:
    folder.mkdir()
    return [(seed, folder) for seed in SEEDS]


def played_at(place: Executor, folder: Path) -> dict[int, Result]:
    """Results by seed; each ends once, and none is lost."""
    ended: list[Result] = []
    lost: list[str] = []
    ends = JobCallbacks(lambda _, result: ended.append(result), lambda key, _: lost.append(key))
    jobs = {f"seed {job[0]}": job for job in jobs_in(folder)}
    job_pool.run(short_rollouts.play, jobs, place, ends)
    assert not lost and len(ended) == len(jobs)
    return {result.seed: result for result in ended}


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Result]:
    """Of the same roll-outs, one after another in this process."""
    folder = tmp_path_factory.mktemp("here")
    results = [short_rollouts.play(job) for job in jobs_in(folder / "begun")]
    assert len({result.hash for result in results}) == len(SEEDS), "all state hashes differ"
    return {result.seed: result for result in results}


def kill_soon(folder: Path, seed: int, killed: list[int]) -> threading.Thread:
    """Kills the process that plays a seed, in the middle of it, once."""

    def watch() -> None:
        deadline = time.monotonic() + 120
        file = folder / f"{seed}.0"
        while time.monotonic() < deadline:
            if file.exists() and (pid := file.read_text().strip()):
                time.sleep(0.02)  # into the roll-out, which takes a second
                os.kill(int(pid), signal.SIGKILL)
                killed.append(int(pid))
                return
            time.sleep(0.01)

    thread = threading.Thread(target=watch)
    thread.start()
    return thread


@pytest.mark.parametrize(
    "executor", ["process", pytest.param("dask", marks=[dask_is_there, pytest.mark.full])]
)
def test_a_worker_that_dies_in_a_rollout_costs_nothing_but_time(
    executor: str, tmp_path: Path, expected: dict[int, Result]
) -> None:
    killed = list[int]()
    watcher = kill_soon(tmp_path / "begun", 1, killed)
    found = played_at(Executor(executor, 2), tmp_path / "begun")
    watcher.join()
    assert killed and killed[0] != os.getpid()
    assert (tmp_path / "begun" / "1.1").exists(), "the killed roll-out was played again"
    assert found == expected


@dask_is_there
def test_a_cluster_of_others_is_used_and_left_running(
    tmp_path: Path, expected: dict[int, Result]
) -> None:
    import distributed

    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs="CRITICAL"
    ) as cluster:
        place = Executor("dask", scheduler=cluster.scheduler_address)
        assert played_at(place, tmp_path / "begun") == expected
        with distributed.Client(cluster) as client:
            workers = set(client.run(os.getpid).values())
        played = {int(file.read_text()) for file in (tmp_path / "begun").iterdir()}
        assert played == workers
