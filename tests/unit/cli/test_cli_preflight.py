"""What a first hour runs into: each ends in one sentence with the cure, before anything starts."""

from __future__ import annotations

import collections
import errno
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from surg_cli import __main__ as entry
from surg_cli.host import environment, paths, preflight, provision, rendering, workspace
from surg_cli.host.terminal import CliError

Usage = collections.namedtuple("Usage", "total used free")


def deny(monkeypatch: pytest.MonkeyPatch, *folders: Path) -> None:
    """Refuse writing to folders; the tests may run as root, to whom nothing is refused."""
    allowed = os.access
    monkeypatch.setattr(
        os, "access", lambda path, mode: path not in folders and allowed(path, mode)
    )


def test_a_path_with_a_space_is_refused_before_the_set_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(CliError, match="without spaces"):
        preflight.check_path(tmp_path / "my checkout")
    preflight.check_path(tmp_path)
    monkeypatch.setattr(preflight.check_path, "__defaults__", (Path("/home/me/my surg"),))
    monkeypatch.setattr(provision, "install_packages", lambda log: pytest.fail("began"))
    with pytest.raises(CliError, match="without spaces"):
        provision.make_ready()


def test_a_tree_of_another_user_is_not_built(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "build").mkdir()
    preflight.check_tree(tmp_path)
    deny(monkeypatch, tmp_path / "build")
    with pytest.raises(CliError, match="owner"):
        preflight.check_tree(tmp_path)


def test_what_is_written_can_be_read_by_other_users(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        paths.write_text(tmp_path / "stamp", "x")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "stamp").stat().st_mode) == 0o644


def test_a_tree_that_cannot_be_written_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Logs and the list of running systems then lie in the user's cache."""
    in_tree = tmp_path / "tree" / ".surg"
    in_tree.parent.mkdir()
    assert paths.state_folder(in_tree) == in_tree
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    deny(monkeypatch, in_tree.parent)
    assert (tmp_path / "cache") in paths.state_folder(in_tree).parents
    assert workspace.STAMP.parent == paths.TREE_STATE


@pytest.mark.parametrize("where", ["folder", "new/below"])
def test_an_out_folder_that_cannot_be_written(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "folder" if where == "folder" else tmp_path
    folder.mkdir(exist_ok=True)
    out = tmp_path / where
    assert paths.run_folder(out) == out
    deny(monkeypatch, folder)
    with pytest.raises(CliError, match="--out") as caught:
        paths.run_folder(out)
    assert caught.value.code == 2


def test_an_out_folder_below_a_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CliError, match="not a folder"):
        paths.run_folder(tmp_path / "file" / "out")


def test_little_space_is_said_before_anything_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "not" / "yet"
    preflight.check_space(out)
    monkeypatch.setattr(
        preflight.shutil, "disk_usage", lambda path: Usage(2**40, 2**40 - 2**30, 2**30)
    )
    with pytest.raises(CliError, match=r"1\.0 GiB"):
        preflight.check_space(out)
    assert not out.exists()


def test_a_half_made_environment_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C in `python -m venv` leaves a Python without pip."""
    venv = tmp_path / ".venv"
    argv = [sys.executable, "-m", "venv", "--without-pip", "--system-site-packages", str(venv)]
    subprocess.run(argv, check=True)
    (venv / "left").write_text("")
    monkeypatch.setattr(paths, "VENV", venv)
    monkeypatch.setattr(paths, "VENV_PYTHON", venv / "bin" / "python")
    monkeypatch.setattr(provision, "VENV_STAMP", venv / ".surg-lock")
    ran: list[list[str]] = []

    def run(command: list[str], *_: object, **__: object) -> None:
        ran.append(command)
        venv.mkdir(exist_ok=True)

    monkeypatch.setattr(provision.logged, "run", run)
    assert provision.install_python(tmp_path / "log")
    assert "venv" in ran[0] and "pip" in ran[1]
    assert not (venv / "left").exists()


@pytest.mark.parametrize("code", [errno.EACCES, errno.ENOSPC, errno.EROFS])
def test_no_error_of_the_system_is_a_traceback(
    code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(arguments: object) -> int:
        raise OSError(code, os.strerror(code), "/somewhere/file")

    monkeypatch.setattr(entry, "run", fail)
    monkeypatch.setattr(entry, "interrupt_on_signals", lambda: None)
    assert entry.main() == 1
    text = capsys.readouterr().err
    assert "/somewhere/file" in text and preflight.CURES[code] in text
    assert text.count("\n") == 1


def test_osmesa_steps_in_where_egl_does_not_work(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """EGL is broken for real: a device that does not exist."""
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setenv("MUJOCO_EGL_DEVICE_ID", "15")
    monkeypatch.setattr(rendering.ctypes.util, "find_library", lambda name: "libOSMesa.so.8")
    assert environment.for_nodes()["MUJOCO_GL"] == "osmesa"
    assert capsys.readouterr().err.count("\n") == 1
    monkeypatch.setenv("MUJOCO_GL", "egl")
    assert rendering.backend() == "egl"


def test_egl_is_used_where_it_works(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(rendering, "egl_works", lambda: True)
    assert rendering.backend() == "egl"
