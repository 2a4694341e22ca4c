"""`rcm_replay --black-box` refuses with words what it cannot read."""

import subprocess
from pathlib import Path

from surg_cli.host import environment, paths

PROGRAM = paths.ROOT / "devel" / "lib" / "surg_control" / "rcm_replay"


def replay(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(PROGRAM), *arguments], capture_output=True, text=True, env=environment.for_nodes()
    )


def test_a_file_that_is_no_black_box_is_refused_with_words(tmp_path: Path) -> None:
    """What else can be wrong with one: test_black_box.cpp."""
    path = tmp_path / "a.blackbox"
    path.write_bytes(b"stamp_ns,tick\n1,2\n")
    done = replay("--black-box", str(path))
    assert done.returncode == 1
    assert "not a black box" in done.stderr and str(path) in done.stderr


def test_a_missing_file_and_wrong_arguments_say_what_is_wrong(tmp_path: Path) -> None:
    done = replay("--black-box", str(tmp_path / "nowhere"))
    assert done.returncode == 1
    assert "No such file" in done.stderr
    for arguments in (["--black-box"], ["--black-box", "a", "b"], ["a.csv"], []):
        assert replay(*arguments).returncode == 2
