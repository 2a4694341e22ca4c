"""Setting a machine up: what is missing, who may install it, and when nothing is to be done."""

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from surg_cli import command_table
from surg_cli.graph import system
from surg_cli.graph.processes import Supervisor
from surg_cli.graph.system import Node
from surg_cli.host import distribution, environment, logged, paths, provision, workspace
from surg_cli.host.terminal import CliError, Progress


def test_package_list_ignores_comments(tmp_path: Path) -> None:
    path = tmp_path / "list"
    path.write_text("# heading\n\ncmake   # builds\nlibegl1\n")
    assert provision.listed_packages(path) == ["cmake", "libegl1"]


def test_packages_of_tests_and_exports_wait_for_their_commands(tmp_path: Path) -> None:
    path = tmp_path / "list"
    path.write_text("cmake\n# == opencv\ncv\n# == later\nchromium  # tests\n")
    assert provision.listed_packages(path, everything=False) == ["cmake"]
    assert provision.listed_packages(path, False, ["opencv"]) == ["cmake", "cv"]
    assert provision.listed_packages(path) == ["cmake", "cv", "chromium"]
    first = set(provision.listed_packages(everything=False))
    later = set(provision.listed_packages()) - first
    assert {"chromium", "clang-tidy", "python3-opencv", "python3-pytest", "python3-torch"} <= later
    assert {"cmake", "python3-rospy", "libegl1"} <= first
    waiting = {name for name, each in command_table.COMMANDS.items() if each.everything}
    assert waiting == {"test", "dev test", "episode export", "dev bench"}
    seeing = {name for name, each in command_table.COMMANDS.items() if "opencv" in each.packages}
    assert seeing == {"calibrate", "check-frames", "episode depth", "episode import"}


@pytest.mark.parametrize(
    ("node", "asked"),
    [
        (Node("/endoscope", "surg_perception", "capture_node.py"), 1),
        (Node("/sim", "surg_sim", "sim_bridge_node.py", {"setting": "phantom+lens"}), 1),
        (Node("/sim", "surg_sim", "sim_bridge_node.py", {"setting": "phantom"}), 0),
    ],
)
def test_opencv_comes_with_a_real_endoscope_or_a_lens(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, node: Node, asked: int
) -> None:
    installed: list[object] = []
    monkeypatch.setattr(provision, "install_packages", lambda *_, **words: installed.append(words))
    monkeypatch.setattr(system.master, "call", lambda *_: None)
    monkeypatch.setattr(system, "executable", lambda *_: "/bin/true")
    with Supervisor({}, tmp_path) as supervisor:
        supervisor.env["ROS_MASTER_URI"] = "http://localhost:1"
        system.start(supervisor, node)
    assert installed == asked * [{"optional": ("opencv",)}]


def test_the_overview_names_each_stage_that_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provision, "missing_packages", lambda names: ["cmake", "libegl1"])
    monkeypatch.setattr(provision, "python_is_current", lambda: False)
    monkeypatch.setattr(workspace, "is_current", lambda: True)
    assert provision.overview(False).startswith("first: 2 Debian packages (1 to 5 minutes), then a")
    monkeypatch.setattr(provision, "missing_packages", lambda names: [])
    monkeypatch.setattr(provision, "python_is_current", lambda: True)
    assert provision.overview(True) == ""


def test_missing_packages_are_those_dpkg_does_not_call_installed() -> None:
    names = ["coreutils", "surely-no-such-package", "dpkg"]
    assert provision.missing_packages(names) == ["surely-no-such-package"]


def test_without_root_and_sudo_the_one_apt_line_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(provision, "missing_packages", lambda names: ["cmake", "libegl1"])
    monkeypatch.setattr(provision.os, "geteuid", lambda: 1000)
    monkeypatch.setattr(provision.shutil, "which", lambda name, path=None: None)
    with pytest.raises(CliError) as caught:
        provision.install_packages(tmp_path / "log")
    line = "apt-get update && apt-get install -y --no-install-recommends cmake libegl1\n"
    assert line in str(caught.value)


def test_a_sudo_that_asks_for_a_password_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sudo = tmp_path / "sudo"
    sudo.write_text("#!/bin/sh\nexit 1\n")
    sudo.chmod(0o755)
    monkeypatch.setattr(provision, "missing_packages", lambda names: ["cmake"])
    monkeypatch.setattr(provision.os, "geteuid", lambda: 1000)
    monkeypatch.setattr(provision.shutil, "which", lambda name, path=None: str(sudo))
    with pytest.raises(CliError, match="neither root nor passwordless sudo"):
        provision.install_packages(tmp_path / "log")


def test_nothing_is_done_when_nothing_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(provision, "missing_packages", lambda names: [])
    monkeypatch.setattr(provision.logged, "run", lambda *a, **k: pytest.fail("ran a program"))
    assert not provision.install_packages(tmp_path / "log")


def test_a_failing_step_shows_the_end_of_its_output(tmp_path: Path) -> None:
    log = tmp_path / "log"
    argv = ["/bin/sh", "-c", "echo the reason; exit 3"]
    with pytest.raises(CliError, match="the reason") as caught:
        logged.run(argv, log, Progress("x"))
    assert str(log) in str(caught.value)
    assert "the reason" in log.read_text()


def test_a_log_is_continued_or_replaced_and_progress_sees_every_line(tmp_path: Path) -> None:
    log = tmp_path / "folder" / "log"
    seen: list[int] = []

    def fraction(lines: Sequence[str]) -> None:
        seen.append(len(lines))

    for word, anew in (("one", True), ("two", False), ("three", True), ("four", False)):
        argv = ["/bin/sh", "-c", f"echo {word}; echo again >&2"]
        logged.run(argv, log, Progress("x"), anew=anew, fraction=fraction)
    assert seen == 4 * [1, 2]
    text = log.read_text()
    assert "one" not in text and "two" not in text
    assert text.index("three") < text.index("four")


def test_progress_is_read_from_make() -> None:
    assert workspace.make_fraction(["-- Configuring"]) is None
    assert workspace.make_fraction(["[  5%] a", "[ 42%] Building", "a warning"]) == 0.42


def test_foreign_python_and_workspace_do_not_leak() -> None:
    dirty = {
        "PATH": "/home/me/.pyenv/shims:/opt/conda/bin:/usr/bin",
        "PYTHONPATH": "/elsewhere",
        "PYTHONHOME": "/elsewhere",
        "CONDA_PREFIX": "/opt/conda",
        "CMAKE_PREFIX_PATH": "/other/devel",
        "ROS_PACKAGE_PATH": "/other/src",
        "HOME": "/home/me",
    }
    env = environment.clean(dirty)
    folders = env["PATH"].split(":")
    assert folders[0] == str(paths.VENV / "bin")
    assert folders.index("/usr/bin") < folders.index("/home/me/.pyenv/shims")
    assert not {"PYTHONPATH", "PYTHONHOME", "CONDA_PREFIX", "CMAKE_PREFIX_PATH"} & set(env)
    assert env["HOME"] == "/home/me"


def test_another_python_first_on_path_changes_nothing(tmp_path: Path) -> None:
    for name in ("python", "python3", "cmake"):
        fake = tmp_path / name
        fake.write_text("#!/bin/sh\necho foreign >&2\nexit 9\n")
        fake.chmod(0o755)
    env = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHONHOME": "/nowhere"}
    done = subprocess.run(
        [str(paths.ROOT / "surg"), "help"], env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "demo" in done.stdout
    assert "foreign" not in done.stderr


@pytest.mark.skipif(not shutil.which("git"), reason="missing: git")
def test_what_the_build_writes_is_no_source() -> None:
    """Else the first command after the first build builds again."""
    listing = ["git", "-C", str(paths.ROOT), "check-ignore", "--stdin"]
    names = "\n".join(map(str, workspace.source_files()))
    ignored = subprocess.run(listing, input=names, capture_output=True, text=True, check=False)
    assert ignored.stdout == "" and ignored.returncode == 1, ignored


def test_fingerprint_follows_the_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = tmp_path / "src" / "package" / "a.cpp"
    source.parent.mkdir(parents=True)
    source.write_text("int a;")
    (tmp_path / "CMakeLists.txt").write_text("")
    monkeypatch.setattr(paths, "ROOT", tmp_path)
    before = workspace.fingerprint()
    cache = source.parent / "__pycache__" / "a.pyc"
    cache.parent.mkdir()
    cache.write_text("x")
    assert workspace.fingerprint() == before
    source.write_text("int ab;")
    changed = workspace.fingerprint()
    assert changed != before
    module, setup = source.with_name("a.py"), source.with_name("setup.py")
    module.write_text("a = 1")
    setup.write_text("b = 1")
    named = workspace.fingerprint()
    assert named != changed
    module.write_text("a = 12")
    assert workspace.fingerprint() == named, "Python runs where it stands"
    setup.write_text("b = 12")
    assert workspace.fingerprint() != named
    source.with_name("b.cpp").write_text("")
    assert workspace.fingerprint() not in (before, changed)


def test_compiler_errors_come_before_the_last_lines(tmp_path: Path) -> None:
    lines = ["[ 1%] Building", "a.cpp:3:1: error: no such type", *[f"noise {i}" for i in range(99)]]
    text = workspace.failure_text(lines, tmp_path / "log")
    assert "no such type" in text
    assert "noise 98" not in text


def release(name: str, version: str, title: str, more: str = "") -> str:
    """An os-release file."""
    return f'ID={name}\n{more}VERSION_ID="{version}"\nPRETTY_NAME="{title}"\n'


RELEASES = {
    "debian 13": release("debian", "13", "Debian GNU/Linux 13 (trixie)"),
    "ubuntu 24.04": release("ubuntu", "24.04", "Ubuntu 24.04.3 LTS", "ID_LIKE=debian\n"),
    "ubuntu 22.04": release("ubuntu", "22.04", "Ubuntu 22.04.5 LTS", "ID_LIKE=debian\n"),
    "fedora 41": release("fedora", "41", "Fedora Linux 41"),
}


@pytest.mark.parametrize(
    ("system", "machine", "python", "said", "refused"),
    [
        ("debian 13", "x86_64", (3, 13), "", ""),
        ("debian 13", "aarch64", (3, 13), "on aarch64 is untried", ""),
        ("ubuntu 24.04", "x86_64", (3, 12), "Ubuntu 24.04.3 LTS on x86_64 is untried", ""),
        ("ubuntu 22.04", "x86_64", (3, 10), "", "22.04.5 LTS has Python 3.10, and 3.11 or later"),
        ("fedora 41", "x86_64", (3, 13), "", "Fedora Linux 41 has no Debian packages"),
        ("", "x86_64", (3, 13), "", "This system has no Debian packages"),
    ],
)
def test_a_system_that_was_never_tried_is_named(
    system: str,
    machine: str,
    python: tuple[int, int],
    said: str,
    refused: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    file = tmp_path / "os-release"
    if system:
        file.write_text(RELEASES[system])
    monkeypatch.setattr(distribution.platform, "machine", lambda: machine)
    monkeypatch.setattr(distribution.sys, "version_info", (*python, 1))
    here = distribution.here(file)
    if refused:
        with pytest.raises(CliError, match=refused) as caught:
            here.untried()
        assert caught.value.code == 2 and "Dockerfile" in str(caught.value)
        return
    assert here.key == f"{system} {machine} Python {python[0]}.{python[1]}"
    assert here.tried == (not said) and said in here.untried()
    browser = "chromium-browser" if "ubuntu" in system else "chromium"
    assert [here.package(name) for name in ("cmake", "chromium")] == ["cmake", browser]


def test_what_another_system_has_built_is_built_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A checkout on a shared disk or a stick."""
    venv, build, ran = tmp_path / ".venv", tmp_path / "build", []
    for name, path in {"VENV": venv, "VENV_PYTHON": venv / "python", "BUILD": build}.items():
        monkeypatch.setattr(paths, name, path)
    monkeypatch.setattr(provision, "VENV_STAMP", venv / "stamp")
    monkeypatch.setattr(workspace, "BUILT_ON", build / "built-on")
    monkeypatch.setattr(workspace, "STAMP", tmp_path / "build.stamp")
    monkeypatch.setattr(workspace, "_cmake", lambda: "cmake")
    monkeypatch.setattr(logged, "run", lambda argv, *_, **__: ran.append(argv))
    other = "debian 12 aarch64 Python 3.11"
    for folder in (venv, build):
        folder.mkdir()
        (folder / "of_the_other").write_text("")
    (venv / "python").write_text("")
    (venv / "stamp").write_text(f"{paths.file_digest(paths.LOCK_FILE)} {other}")
    (build / "built-on").write_text(other)
    (build / "CMakeCache.txt").write_text("")
    assert not provision.python_is_current()
    monkeypatch.setattr(provision, "pip_install", lambda *_: None)
    assert provision.install_python(tmp_path / "log") and workspace.build(tmp_path / "log")
    assert not (venv / "of_the_other").exists() and not (build / "of_the_other").exists()
    assert capsys.readouterr().out.count(other) == 2
    assert [argv[0] for argv in ran[1:]] == ["cmake", "cmake"]
    (build / "of_this").write_text("")
    workspace.build(tmp_path / "log", force=True)
    assert (build / "of_this").exists()
