"""Several pytests that share one list: each test runs once, and what they print can be read."""

from __future__ import annotations

import os
import sys
from collections import Counter
from pathlib import Path

import pytest

from surg_cli.host import paths, pytest_workers

FILES, EACH = 12, 4
CONFTEST = """
import os
import time
from pathlib import Path

import pytest

from helpers.graph.claims import Claims

here = Path(__file__).parent


def pytest_configure(config):
    claims, worker = os.environ.pop("SURG_TEST_CLAIMS"), os.environ.pop("SURG_TEST_WORKER")
    config.pluginmanager.register(Claims(Path(claims), worker == "0", here))
    config.worker = worker


@pytest.fixture(scope="module")
def made(request):
    yield
    with (here / "ended").open("a") as stream:
        stream.write(f"{request.config.worker} {request.module.__name__}\\n")
"""
NOTED = """

@pytest.fixture(autouse=True)
def noted(request):
    ran, worker = here / "ran", request.config.worker
    with ran.open("a") as stream:
        stream.write(f"{worker} {request.node.nodeid}\\n")
    end = time.monotonic() + 60.0
    while worker == "0" and time.monotonic() < end:
        if any(line[0] != "0" for line in ran.read_text().splitlines()):
            break  # the others are there, however late this machine has begun them
        time.sleep(0.02)
"""
TEST = """
import pytest

pytestmark = [pytest.mark.{mark}]


@pytest.mark.parametrize("number", range({each}))
def test_it(number, made):
    assert number != {wrong}, "wrong:" + "-" * 40
"""


def tree(root: Path) -> None:
    """Tests in two folders; the third of every other file fails."""
    for i in range(FILES):
        folder = root / ("ros" if i % 3 == 0 else "unit")
        folder.mkdir(parents=True, exist_ok=True)
        wrong = 2 if i % 2 else -1
        mark = "untimed" if i == 9 else "timed"
        (folder / f"test_{i:02d}.py").write_text(TEST.format(each=EACH, wrong=wrong, mark=mark))
    (root / "conftest.py").write_text(CONFTEST + NOTED)


def test_they_share_and_are_counted_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    tree(tmp_path)
    monkeypatch.setattr(pytest_workers.workspace, "jobs", lambda: 8)
    argv = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--import-mode=importlib"]
    argv += ["--rootdir", str(tmp_path), "-c", os.devnull, str(tmp_path)]
    env = {**os.environ, "PYTHONPATH": str(paths.ROOT / "tests")}
    env["PYTHONDONTWRITEBYTECODE"] = "1"
    status, counts = pytest_workers.run(argv, env, shared=True)

    shown = capfd.readouterr().out
    assert status == 1
    assert (counts["passed"], counts["failed"]) == (FILES * EACH - FILES // 2, FILES // 2), shown
    ran = [line.split(" ", 1) for line in (tmp_path / "ran").read_text().splitlines()]
    assert Counter(Counter(name for _, name in ran).values()) == {1: FILES * EACH}
    by_file: dict[str, set[str]] = {}
    for worker, name in ran:
        by_file.setdefault(name.split("::")[0], set()).add(worker)
    assert all(len(workers) == 1 for workers in by_file.values())
    live = {worker for worker, name in ran if "ros/" in name and "09" not in name}
    assert live == {"0"}
    assert not any(worker == "0" for worker, name in ran if "ros/test_09" in name)
    assert len({worker for worker, _ in ran}) > 1, "nobody helped the first"
    # A module's fixture ends once, with its last test.
    ended = (tmp_path / "ended").read_text().splitlines()
    assert len(ended) == FILES
    # From a worker's failures to its last line nobody else speaks.
    lines = shown.splitlines()
    for begin in (i for i, line in enumerate(lines) if " FAILURES " in line):
        end = next(i for i in range(begin, len(lines)) if " in " in lines[i])
        named = sum(line.startswith("FAILED ") for line in lines[begin:end])
        assert named == pytest_workers.parse_counts(lines[end])["failed"], shown
    print(f"{len(ran)} tests, {len({worker for worker, _ in ran})} workers")


def test_one_that_ends_otherwise_is_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "unit").mkdir()
    (tmp_path / "conftest.py").write_text(CONFTEST)
    (tmp_path / "unit" / "test_end.py").write_text(
        "def test_it():\n    __import__('os')._exit(7)\n"
    )
    monkeypatch.setattr(pytest_workers.workspace, "jobs", lambda: 2)
    argv = [sys.executable, "-m", "pytest", "--import-mode=importlib", "--rootdir", str(tmp_path)]
    argv += ["-c", os.devnull, str(tmp_path)]
    env = {**os.environ, "PYTHONPATH": str(paths.ROOT / "tests")}
    status, counts = pytest_workers.run(argv, env, shared=True)
    assert status == 7
    assert counts["passed"] == 0


def test_one_core_has_one_pytest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pytest_workers.workspace, "jobs", lambda: 1)
    program = "import os; print('1 passed in 0.1s', 'SURG_TEST_CLAIMS' in os.environ)"
    assert pytest_workers.run([sys.executable, "-c", program], os.environ, shared=True) == (
        0,
        {"passed": 1},
    )
