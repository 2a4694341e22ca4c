"""Many recordings: executors, shards, work that was cut off, workers that are killed."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from helpers.recording import datasets_synthetic
from helpers.results.dataset_results import note
from surg_recording import datasets, job_pool
from surg_recording.datasets import ExportError, ExportOptions, Report, conversion, pipeline
from surg_recording.datasets.conversion import ConversionJob, ConversionResult

SERIAL = ExportOptions(executor="serial")
dask_is_there = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None, reason="python3-distributed is not installed"
)


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording, which no test changes."""
    folder = tmp_path_factory.mktemp("recorded") / "r000"
    return datasets_synthetic.record(folder, 1, 0.4, ("endoscope_left",))


def many(first: Path, tmp_path: Path, count: int) -> list[Path]:
    """Recordings that differ in their seed."""
    others = [
        datasets_synthetic.copy(first, tmp_path / f"r{i:03d}", seed=100 + i)
        for i in range(1, count)
    ]
    return [first, *others]


def export(
    folders: list[Path], out: Path, options: ExportOptions, format_name: str = "act"
) -> Report:
    return datasets.load(format_name).write(folders, out, options)


def content(out: Path) -> dict[str, str]:
    """Checksums of a dataset's files, the manifest left out."""
    stated = json.loads((out / "surg_export.json").read_text())
    return {name: entry["sha256"] for name, entry in stated["files"].items()}


def test_all_executors_make_the_same_files(first: Path, tmp_path: Path) -> None:
    folders, found = many(first, tmp_path, 3), []
    for executor in ("serial", "process"):
        out = tmp_path / executor / "set"
        out.parent.mkdir()
        options = ExportOptions(executor=executor, workers=2)
        # In a new process, as the pool's are: what other tests have loaded must not count.
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as fresh:
            write = datasets.load("lerobot_v30").write
            report = fresh.submit(write, folders, out, options).result()
        assert report.ok, report
        assert report.made == 3
        found.append(content(out))
    assert found[0] == found[1]


def test_shards_and_merge_give_the_same_dataset(first: Path, tmp_path: Path) -> None:
    folders = many(first, tmp_path, 5)
    whole, out = tmp_path / "whole" / "set", tmp_path / "merged" / "set"
    whole.parent.mkdir()
    out.parent.mkdir()
    assert export(folders, whole, SERIAL).ok
    for shard in range(3):
        options = dataclasses.replace(SERIAL, shard=(shard, 3))
        report = export(folders, out, options)
        assert report.ok
        assert report.made == len(folders[shard::3])
        assert not out.exists()
        assert export(folders, out, options).made == 0, "idempotent"
    merged = export(folders, out, SERIAL)
    assert merged.ok
    assert merged.made == 0, "all had been converted"
    assert content(out) == content(whole)


def test_work_that_was_cut_off_is_taken_up(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders, out = many(first, tmp_path, 4), tmp_path / "set"
    right, done = pipeline.convert, []

    def interrupted(job: ConversionJob) -> ConversionResult:
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(job)
        return right(job)

    monkeypatch.setattr(pipeline, "convert", interrupted)
    with pytest.raises(KeyboardInterrupt):
        export(folders, out, SERIAL)
    monkeypatch.setattr(pipeline, "convert", right)
    dead = tmp_path / "set.parts" / f".unfinished-{os.uname().nodename}-999999-x"
    dead.mkdir()
    report = export(folders, out, SERIAL)
    assert report.ok
    assert (report.recordings, report.made) == (4, 2)
    assert not dead.parent.exists()
    again = export(folders, out, SERIAL)
    assert again.facts == {"up_to_date": True}
    assert again.made == 0


def test_kept_parts_make_a_larger_export_quick(first: Path, tmp_path: Path) -> None:
    folders, out = many(first, tmp_path, 4), tmp_path / "set"
    options = dataclasses.replace(SERIAL, keep_parts=True, replace=True)
    assert export(folders[:3], out, options).made == 3
    report = export(folders, out, options)
    assert (report.recordings, report.made) == (4, 1)
    other = export(folders, out, dataclasses.replace(options, instruction="something else"))
    assert other.made == 4, "another instruction is other data"


DEADLY = '''
import os, signal
from surg_recording.datasets.formats.act import Act

class Deadly(Act):
    """Kills its process at one recording."""

    name = "deadly"

    def write_part(self, sampled, folder, options):
        if sampled.candidate.about["seed"] == 101:
            os.kill(os.getpid(), signal.SIGKILL)
        super().write_part(sampled, folder, options)
'''


SLEEPER = """
import time
from surg_recording.job_pool import Executor, JobCallbacks, run
if __name__ == "__main__":
    run(time.sleep, {"a job": 600.0}, Executor(workers=1), JobCallbacks(print, print))
"""


def test_no_worker_outlives_its_killed_parent(tmp_path: Path) -> None:
    script = tmp_path / "sleeper.py"
    script.write_text(SLEEPER, "utf-8")
    with subprocess.Popen([sys.executable, str(script)]) as parent:
        listed = Path(f"/proc/{parent.pid}/task/{parent.pid}/children")
        workers: list[Path] = []
        try:
            while not workers:
                assert parent.poll() is None
                time.sleep(0.1)
                children = [Path("/proc", pid) for pid in listed.read_text("ascii").split()]
                workers = [c for c in children if b"spawn_main" in (c / "cmdline").read_bytes()]
            time.sleep(2.0)  # its imports
        finally:
            parent.kill()
    deadline = time.monotonic() + 20.0
    while any(worker.exists() for worker in workers) and time.monotonic() < deadline:
        time.sleep(0.1)
    left = [worker for worker in workers if worker.exists()]
    for worker in left:
        os.kill(int(worker.name), signal.SIGKILL)
    assert not left


def test_a_recording_that_kills_its_process_costs_only_itself(first: Path, tmp_path: Path) -> None:
    folders = many(first, tmp_path, 4)
    file = tmp_path / "deadly.py"
    file.write_text(textwrap.dedent(DEADLY))
    options = ExportOptions(executor="process", workers=2)
    report = export(folders, tmp_path / "set", options, str(file))
    assert report.recordings == 3
    assert list(report.refused) == [str(folders[1])]
    assert "the process that worked on it died" in report.refused[str(folders[1])]


@dask_is_there
def test_a_dask_worker_is_killed_on_the_way(first: Path, tmp_path: Path, full: bool) -> None:
    """All recordings are converted, and a second run does nothing."""
    import distributed

    count = 1000 if full else 4
    folders, out = many(first, tmp_path, count), tmp_path / "set"
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs="CRITICAL"
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        victim = next(iter(client.run(os.getpid).values()))
        killed = threading.Event()

        def kill() -> None:
            deadline = time.monotonic() + 120
            while time.monotonic() < deadline:
                if len(list(tmp_path.glob("set.parts/*/1/part.json"))) >= max(1, count // 8):
                    os.kill(victim, signal.SIGKILL)
                    killed.set()
                    return
                time.sleep(0.005)

        thread = threading.Thread(target=kill)
        thread.start()
        options = ExportOptions(executor="dask", scheduler=cluster.scheduler_address)
        report = export(folders, out, options)
        thread.join()
        assert killed.is_set()
        assert report.ok, report.refused
        assert report.recordings == count
        before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
        again = export(folders, out, options)
        assert again.facts == {"up_to_date": True}
        assert {path: path.stat().st_mtime_ns for path in out.rglob("*")} == before
    note(
        "recordings with a Dask worker killed on the way",
        count,
        f"{report.recordings}/{count} exported; a second run converts {again.made}",
    )


@dask_is_there
def test_a_scheduler_that_is_not_there_is_named(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(job_pool, "CONNECT_S", 1)
    options = ExportOptions(executor="dask", scheduler="tcp://127.0.0.1:1")
    with pytest.raises(ExportError, match="no Dask scheduler answers there"):
        export(many(first, tmp_path, 1), tmp_path / "set", options)


def test_dask_that_is_not_installed_is_named(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ExportError, match="python3-distributed"):
        export(many(first, tmp_path, 1), tmp_path / "set", ExportOptions(executor="dask"))


OUTSIDE = '''
"""Numbers per recording, as CSV: an exporter from outside the tree."""

import csv
import json

from surg_recording.datasets import Exporter, Report


class Table(Exporter):
    """One CSV file per recording."""

    name = "table"
    title = "CSV tables"

    def write_part(self, sampled, folder, options):
        rows = zip(sampled.grid.timestamps, *sampled.columns["action"].T)
        with open(folder / "part.csv", "w", newline="") as file:
            csv.writer(file).writerows(rows)

    def assemble(self, dataset, out):
        for index, part in enumerate(dataset.parts):
            (out / f"{index}.csv").write_bytes((part.folder / "part.csv").read_bytes())
        (out / "lengths.json").write_text(json.dumps([part.frames for part in dataset.parts]))

    def validate(self, out):
        report = Report(self.name, out)
        for index, length in enumerate(json.loads((out / "lengths.json").read_text())):
            with open(out / f"{index}.csv", newline="") as file:
                if len(list(csv.reader(file))) != length:
                    report.errors.append(f"{index}.csv has not {length} rows")
            report.recordings += 1
            report.frames += length
        return report
'''


def test_an_exporter_from_outside_the_tree(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By path, in other processes too, and by the entry point of an installed package."""
    folders = many(first, tmp_path, 2)
    file = tmp_path / "table_exporter.py"
    file.write_text(OUTSIDE)
    options = ExportOptions(executor="process", workers=1)
    report = export(folders, tmp_path / "by_path", options, str(file))
    assert report.ok, report
    assert report.recordings == 2
    lines = (tmp_path / "by_path/0.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in lines[:3]] == ["0.0", "0.05", "0.1"]

    info = tmp_path / "package/table_exporter-1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: table-exporter\nVersion: 1\n")
    (info / "entry_points.txt").write_text(
        "[surg_recording.exporters]\ntable = table_exporter:Table\n"
    )
    (tmp_path / "package/table_exporter.py").write_text(OUTSIDE)
    monkeypatch.syspath_prepend(tmp_path / "package")
    assert "table" in datasets.names()
    assert export(folders, tmp_path / "by_name", SERIAL, "table").ok

    file.write_text(OUTSIDE.replace("def validate", "def check"))
    with pytest.raises(ExportError, match="Table lacks validate"):
        datasets.load(str(file))
    file.write_text("import nothing_of_that_name")
    with pytest.raises(ExportError, match="nothing_of_that_name"):
        datasets.load(str(file))


def test_an_exporter_that_fails_costs_one_recording(first: Path, tmp_path: Path) -> None:
    folders = many(first, tmp_path, 2)
    file = tmp_path / "weak.py"
    weak = OUTSIDE.replace(
        "rows = zip", "1 / (sampled.candidate.about['seed'] - 101)\n        rows = zip"
    )
    file.write_text(weak)
    seeds = [datasets_synthetic.copy(folders[0], tmp_path / "x", seed=7), folders[1]]
    report = export(seeds, tmp_path / "set", SERIAL, str(file))
    assert report.recordings == 1
    assert "ZeroDivisionError" in report.refused[str(folders[1])]


def test_half_a_part_is_never_seen(first: Path, tmp_path: Path) -> None:
    """Two processes at the same recording: one wins, both are content."""
    folder = many(first, tmp_path, 1)[0]
    look = datasets.pipeline.inspection.inspect(folder, SERIAL)
    place = tmp_path / "parts"
    place.mkdir()
    job = ConversionJob(folder, "act", SERIAL, look.layout, "somekey", place)
    threads = [threading.Thread(target=conversion.convert, args=(job,)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [path.name for path in place.iterdir()] == ["somekey"]
    assert not conversion.convert(job).made
