"""`rcm_replay --black-box` refuses with words what it cannot read."""

import subprocess
from pathlib import Path

import pytest

from surg_cli.host import environment, paths

PROGRAM = paths.ROOT / "devel" / "lib" / "surg_control" / "rcm_replay"


def replay(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(PROGRAM), *arguments], capture_output=True, text=True, env=environment.for_nodes()
    )


@pytest.mark.parametrize(
    ("contents", "words"),
    [
        (b"", "not a black box"),
        (b"stamp_ns,tick\n1,2\n", "not a black box"),
        (b"SURGBBX\0", "cut short"),
        (b"SURGBBX\0\x07\0\0\0" + bytes(16), "format version 7"),
        (b"SURGBBX\0\x05\0\0\0" + bytes(100), "length is wrong"),
        (b"SURGBBX\0\x05\0\0\0" + bytes(16), "checksum is wrong"),
    ],
    ids=["empty", "csv", "short", "version", "length", "checksum"],
)
def test_a_file_that_is_not_whole_is_refused_with_words(
    tmp_path: Path, contents: bytes, words: str
) -> None:
    path = tmp_path / "a.blackbox"
    path.write_bytes(contents)
    done = replay("--black-box", str(path))
    assert done.returncode == 1
    assert words in done.stderr
    assert str(path) in done.stderr


def test_a_missing_file_and_wrong_arguments_say_what_is_wrong(tmp_path: Path) -> None:
    done = replay("--black-box", str(tmp_path / "nowhere"))
    assert done.returncode == 1
    assert "No such file" in done.stderr
    for arguments in (["--black-box"], ["--black-box", "a", "b"], ["a.csv"], []):
        assert replay(*arguments).returncode == 2
