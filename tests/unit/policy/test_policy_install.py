"""The client on a machine of its own: its grammar, installation and first words, without ROS."""

import ast
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from helpers.graph.surg import surg
from helpers.policy import pythons
from helpers.policy.policy_server import PolicyServer
from helpers.sim.nudge_task import LUCKY
from surg_cli.host import paths

CLIENT = paths.ROOT / "src" / "surg_policy_bridge" / "client"
ALLOWED = {"msgpack", "numpy", "zmq", "surg_policy_client"}
# Imported where they are used only: adapters, and the dataset that `replay` reads.
OPTIONAL = {"pyarrow", "torch", "lerobot", "websockets", "__future__"}

TALK = """
import importlib, pkgutil, sys
import surg_policy_client
for module in pkgutil.walk_packages(surg_policy_client.__path__, "surg_policy_client."):
    importlib.import_module(module.name)
ros = {"rospy", "genpy", "surg_core", "surg_cli"} & set(sys.modules)
assert not ros, ros
from surg_policy_client.policies.hold import Hold
served = surg_policy_client.serve(Hold(), sys.argv[1], episodes=1, timeout_s=20.0)
print("answered", served.observations, surg_policy_client.__file__)
"""


def sources() -> list[Path]:
    return sorted((CLIENT / "src").rglob("*.py"))


@pytest.mark.parametrize("minor", [8, 13])
def test_every_file_is_python_3_8(minor: int) -> None:
    for path in sources():
        ast.parse(path.read_text("utf-8"), str(path), feature_version=(3, minor))
    assert len(sources()) > 15


def test_a_newer_grammar_is_noticed() -> None:
    with pytest.raises(SyntaxError):
        ast.parse("match x:\n  case 1: pass", feature_version=(3, 8))


def test_it_needs_numpy_pyzmq_and_msgpack_alone() -> None:
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, path
                names = [node.module or ""]
            tops = {name.split(".")[0] for name in names}
            strange = tops - ALLOWED - OPTIONAL - set(sys.stdlib_module_names)
            assert not strange, f"{path}:{node.lineno}: {strange}"


def started(python: Path, folder: Path, *words: str) -> subprocess.Popen[str]:
    """A program of a Python of its own, in an environment that knows nothing of ours."""
    return subprocess.Popen(
        [str(python), "-I", *words],
        cwd=folder,
        env={k: v for k, v in os.environ.items() if k in ("HOME", "PATH", "LANG", "TMPDIR")},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def talk(python: Path, folder: Path) -> str:
    """Let a Python of its own connect to a server and answer three observations."""
    with PolicyServer() as server:
        program = started(python, folder, "-c", TALK, server.address)
        try:
            server.wait("PING", 30.0)
            for step in range(3):
                act = server.ask(step)
                assert act.arrays["chunk"].shape == (8, 5)
            server.episode(0, "end", True)
            said, _ = program.communicate(timeout=20.0)
        finally:
            program.kill()
    assert program.returncode == 0, said
    assert "answered 3" in said, said
    return said


def hold(python: Path, folder: Path) -> int:
    """Let it hold the arms for an episode of the running system; the steps that were accepted."""
    address = f"ipc://{folder}/server"
    task, out = paths.ROOT / "tests" / "helpers" / "sim" / "nudge_task.py", folder / "run"
    words = ("run", task, "--policy", address, "--seed", LUCKY, "--out", out)
    client = started(python, folder, "-m", "surg_policy_client.policies.hold", "--server", address)
    try:
        done = surg(*words)
    finally:
        client.terminate()
        said, _ = client.communicate(timeout=20.0)
    summary = out / "summary.json"
    assert summary.exists(), done.stdout + done.stderr + said
    (entry,) = json.loads(summary.read_text("utf-8"))["episodes"]
    assert not entry["success"], "nothing moved"
    policy = entry["policy"]
    assert policy["policy"] == "Hold" and policy["rejected"] == 0, policy
    assert policy["accepted"] > 50, (policy, said)
    return int(policy["accepted"])


def copied(folder: Path) -> Path:
    """The client as on a machine that got nothing else."""
    ignore = shutil.ignore_patterns("__pycache__", "*.egg-info", "build")
    return Path(shutil.copytree(CLIENT, folder / "client", ignore=ignore))


def test_it_installs_into_an_environment_of_the_systems_python(tmp_path: Path) -> None:
    venv = tmp_path / "venv"
    argv = [str(paths.SYSTEM_PYTHON), "-m", "venv", "--system-site-packages", "--without-pip"]
    subprocess.run([*argv, str(venv)], check=True, timeout=120, capture_output=True)
    python = venv / "bin" / "python"
    # The three dependencies are the system's; what is tested is that the package is complete.
    install = [str(paths.SYSTEM_PYTHON), "-m", "pip", "--python", str(python), "install", "-q"]
    install += ["--no-deps", "--no-index", "--no-build-isolation"]
    env = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    subprocess.run(
        [*install, str(copied(tmp_path))],
        check=True,
        timeout=120,
        capture_output=True,
        env=env,
    )
    assert str(venv) in talk(python, tmp_path)


@pytest.mark.oracle
@pytest.mark.parametrize("version", ["3.8", "3.12", "3.13"])
def test_it_installs_into_a_clean_python(version: str, tmp_path: Path) -> None:
    python = pythons.find(version)
    if python is None:
        pytest.skip(f"missing: Python {version}; `uv python install {version}` or pyenv get it")
    venv = tmp_path / "venv"
    subprocess.run([str(python), "-m", "venv", str(venv)], check=True, timeout=120)
    pip = [str(venv / "bin" / "python"), "-m", "pip", "--disable-pip-version-check", "install"]
    env = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    done = subprocess.run(
        [*pip, "-q", str(copied(tmp_path))], capture_output=True, text=True, timeout=600, env=env
    )
    assert done.returncode == 0, done.stderr
    print(version, talk(venv / "bin" / "python", tmp_path).splitlines()[-1])
    print(version, f"{hold(venv / 'bin' / 'python', tmp_path)} steps accepted by the model server")
