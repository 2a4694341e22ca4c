"""`./surg test` with several workers: each test once, real time in one worker, right counts."""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from helpers.graph import worker_groups
from surg_cli.commands.dev import run_tests as run_tests_command
from surg_cli.host import paths, pytest_run

FILES, EACH = 12, 4
UNTIMED, TIMED = 9, 10
CONFTEST = """
import os
import time
from pathlib import Path

import pytest

from helpers.graph import worker_groups

here = Path(__file__).parent
worker = os.environ.get("PYTEST_XDIST_WORKER")


@pytest.hookimpl(hookwrapper=True, tryfirst=True)
def pytest_runtest_protocol(item):
    with worker_groups.priority(item, here):
        yield


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    worker_groups.assign(config, items, here)


@pytest.fixture(scope="module")
def made(request):
    yield
    with (here / "ended").open("a") as stream:
        stream.write(f"{worker} {request.module.__name__}\\n")


@pytest.fixture(autouse=True)
def noted(request):
    name = request.node.nodeid.removesuffix("@" + worker_groups.group(request.node))
    with (here / "ran").open("a") as stream:
        stream.write(f"{worker} {os.nice(0)} {name}\\n")
    time.sleep(0.05)
"""
TEST = """
import pytest

pytestmark = [pytest.mark.{mark}]


@pytest.mark.parametrize("number", range({each}))
def test_it(number, made):
    assert number != {wrong}, "wrong:" + "-" * 40
"""

FAILS = """
from pathlib import Path


def test_it():
    tried = Path(__file__).parent / "tried"
    with tried.open("a") as stream:
        stream.write("x")
    assert tried.stat().st_size > {failures}
"""
TESTS, TOOLS = paths.ROOT / "tests", paths.ROOT / "tools"


def write_tests(root: Path) -> None:
    """Tests in two folders; the third of every other file fails."""
    for i in range(FILES):
        folder = root / ("ros" if i % 3 == 0 else "unit")
        folder.mkdir(parents=True, exist_ok=True)
        wrong = 2 if i % 2 else -1
        mark = {UNTIMED: "untimed", TIMED: "timed"}.get(i, "ordinary")
        (folder / f"test_{i:02d}.py").write_text(TEST.format(each=EACH, wrong=wrong, mark=mark))
    (root / "conftest.py").write_text(CONFTEST)


def command(root: Path) -> tuple[list[str], dict[str, str]]:
    argv = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--import-mode=importlib"]
    argv += ["--rootdir", str(root), "-c", os.devnull]
    path = os.pathsep.join((str(TESTS), str(TOOLS)))
    return argv, {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}


def run_tests(root: Path) -> tuple[int, Counter[str]]:
    argv, env = command(root)
    return pytest_run.run(argv, [str(root)], env, parallel=True)


def test_every_test_runs_once_and_real_time_in_one_worker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_tests(tmp_path)
    monkeypatch.setattr(pytest_run.workspace, "jobs", lambda: 8)
    monkeypatch.setattr(pytest_run, "MAX_REPEATED", FILES // 2 - 1)
    status, counts = run_tests(tmp_path)
    assert status == 1
    assert (counts["passed"], counts["failed"]) == (FILES * EACH - FILES // 2, FILES // 2)
    ran = [line.split(" ", 2) for line in (tmp_path / "ran").read_text().splitlines()]
    assert Counter(Counter(name for *_, name in ran).values()) == {1: FILES * EACH}
    workers: dict[str, set[str]] = {}
    for worker, _, name in ran:
        workers.setdefault(name.split("::")[0], set()).add(worker)
    assert all(len(each) == 1 for each in workers.values())
    timed = {f"ros/test_{i:02d}.py" for i in range(0, FILES, 3) if i != UNTIMED}
    timed.add(f"unit/test_{TIMED:02d}.py")
    (first,) = {worker for file in timed for worker in workers[file]}
    assert len({worker for each in workers.values() for worker in each}) > 1
    # The worker for real time has priority, whichever it is; the others have this process's.
    niceness = {worker: int(nice) for worker, nice, _ in ran}
    others = [nice for worker, nice in niceness.items() if worker != first]
    assert niceness[first] < min(others) or os.nice(0) <= worker_groups.PREFERRED
    if os.geteuid() == 0:
        assert niceness[first] == worker_groups.PREFERRED
    # A module's fixture ends once, behind its last test.
    assert len((tmp_path / "ended").read_text().splitlines()) == FILES


def test_a_crashed_worker_is_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "unit").mkdir()
    (tmp_path / "conftest.py").write_text(CONFTEST)
    source = "def test_it():\n    __import__('os')._exit(7)\n"
    (tmp_path / "unit" / "test_end.py").write_text(source)
    monkeypatch.setattr(pytest_run.workspace, "jobs", lambda: 2)
    status, counts = run_tests(tmp_path)
    assert status == 1
    assert (counts["passed"], counts["failed"]) == (0, 1)


def test_one_core_has_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pytest_run.workspace, "jobs", lambda: 1)
    program = "import sys; print(f'{len(sys.argv)} passed in 0.1s')"
    argv = [sys.executable, "-c", program]
    assert pytest_run.run(argv, [], os.environ, parallel=True) == (0, {"passed": 1})


@pytest.mark.parametrize(
    ("folder", "failures", "expected"), [("ros", 1, (0, 2, 0)), ("unit", 2, (1, 1, 1))]
)
def test_a_failed_test_is_repeated_once_alone(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    folder: str,
    failures: int,
    expected: tuple[int, int, int],
) -> None:
    """Fails so many times; the other test passes."""
    monkeypatch.setattr(pytest_run.paths, "ROOT", tmp_path)
    monkeypatch.setattr(pytest_run.workspace, "jobs", lambda: 2)
    (tmp_path / folder).mkdir()
    (tmp_path / "conftest.py").write_text(CONFTEST)
    (tmp_path / "test_other.py").write_text("def test_other():\n    pass\n")
    (tmp_path / folder / "test_it.py").write_text(FAILS.format(failures=failures))
    status, counts = run_tests(tmp_path)
    assert (status, counts["passed"], counts["failed"]) == expected
    assert not counts["errors"]
    tried = (tmp_path / folder / "tried").read_text()
    assert len(tried) == 2


def test_failed_tests_are_found_by_their_ids() -> None:
    late = "tests/ros/test_a.py::test_b[x y]@real-time - assert '@' == 'a - b'\n"
    both = f"FAILED {late}ERROR {late}"  # the test and its fixture's end
    assert pytest_run.failed_tests(both) == ["tests/ros/test_a.py::test_b[x y]"]
    other = "FAILED tests/ros/test_e.py::test_f[tcp://@:1]@graph-test_e\n"
    assert pytest_run.failed_tests(other) == ["tests/ros/test_e.py::test_f[tcp://@:1]"]
    assert not pytest_run.failed_tests(f"worker 'gw1' crashed while running x\nFAILED {late}")


def test_a_whole_run_that_skips_everything_has_failed(
    surg: Callable[..., int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_tests_command.cpp_tests, "run", lambda _: (3, 0))
    counts = Counter({"skipped": 9})
    monkeypatch.setattr(run_tests_command.pytest_run, "run", lambda *_, **__: (0, counts))
    assert surg("test") == 1
    counts["passed"] = 1
    assert surg("test") == 0
