"""Roll-outs in other processes and on Dask: each ends once, as in this process."""

from __future__ import annotations

import importlib.util
import os
import signal
import sys
import threading
import time
from collections import Counter
from pathlib import Path

import pytest

from surg_cli.host import paths
from surg_recording.job_pool import Executor

pytest.importorskip("gymnasium", reason="gymnasium is not installed: ./surg dev setup")
sys.path.insert(0, str(paths.ROOT / "benchmarks"))

import bench_imitation
from bench_imitation import Book, Job, Result

from helpers.sim import short_rollouts

SEEDS = range(6)
dask_is_there = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None, reason="python3-distributed is not installed"
)


def jobs_in(folder: Path) -> list[Job]:
    folder.mkdir()
    return [("circling", seed, folder) for seed in SEEDS]


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, int], Result]:
    """Of the same roll-outs, one after another in this process."""
    folder = tmp_path_factory.mktemp("here")
    results = [short_rollouts.play(job) for job in jobs_in(folder / "begun")]
    assert len({result.reason for result in results}) == len(SEEDS), "all state hashes differ"
    return {(result.condition, result.seed): result for result in results}


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


def lines_of(folder: Path) -> Counter[str]:
    (file,) = folder.glob("*.jsonl")
    return Counter(file.read_text("utf-8").splitlines())


@pytest.mark.parametrize(
    "executor", ["process", pytest.param("dask", marks=[dask_is_there, pytest.mark.full])]
)
def test_a_worker_that_dies_in_a_rollout_costs_nothing_but_time(
    executor: str, tmp_path: Path, expected: dict[tuple[str, int], Result]
) -> None:
    jobs, killed = jobs_in(tmp_path / "begun"), list[int]()
    book = Book(tmp_path / "kept", "f" * 64)
    watcher = kill_soon(tmp_path / "begun", 1, killed)
    books = {tmp_path / "begun": book}
    bench_imitation.run(jobs, books, Executor(executor, 2), short_rollouts.play)
    watcher.join()
    assert killed and killed[0] != os.getpid()
    assert (tmp_path / "begun" / "1.1").exists(), "the killed roll-out was played again"
    assert book.found == expected
    written = lines_of(tmp_path / "kept")
    assert len(written) == len(SEEDS) and set(written.values()) == {1}
    assert Book(tmp_path / "kept", "f" * 64).found == expected


@dask_is_there
def test_a_cluster_of_others_is_used_and_left_running(
    tmp_path: Path, expected: dict[tuple[str, int], Result]
) -> None:
    import distributed

    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs="CRITICAL"
    ) as cluster:
        place = bench_imitation.executor_of(f"dask:{cluster.scheduler_address}")
        book = Book(tmp_path / "kept", "f" * 64)
        books = {tmp_path / "begun": book}
        bench_imitation.run(jobs_in(tmp_path / "begun"), books, place, short_rollouts.play)
        assert book.found == expected
        with distributed.Client(cluster) as client:
            workers = set(client.run(os.getpid).values())
        played = {int(file.read_text()) for file in (tmp_path / "begun").iterdir()}
        assert played == workers


def test_executors_by_name() -> None:
    assert bench_imitation.executor_of("processes") == Executor()
    assert bench_imitation.executor_of("dask") == Executor("dask")
    found = bench_imitation.executor_of("dask:tcp://10.0.0.1:8786")
    assert found == Executor("dask", scheduler="tcp://10.0.0.1:8786")
    with pytest.raises(Exception, match=r"allowed are processes and dask\[:ADDRESS\]"):
        bench_imitation.executor_of("threads")
