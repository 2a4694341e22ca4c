"""surg_sim installs by pip with its data, and runs an episode without ROS and without a tree."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from conftest import FULL
from helpers.tree import installed_core as core
from surg_cli.host import paths

HIDDEN = {
    "rospy", "rosgraph", "genpy", "crtk_msgs", "surg_msgs", "surg_ros", "surg_description",
    "surg_teleop", "surg_recording", "surg_cli",
}  # fmt: skip

_USE = f"""
import importlib, pkgutil, runpy, sys
class NoRos:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {HIDDEN!r}:
            raise ImportError(f"{{name}} is not there")
sys.meta_path.insert(0, NoRos())
import surg_sim
found = [m.name for m in pkgutil.walk_packages(surg_sim.__path__, "surg_sim.")]
for name in found:
    # Nodes need ROS, environments gymnasium, and what writes recordings surg_recording.
    if ".nodes." in name or name.endswith((
        "_node", ".surg_env", ".agent_env", ".env_spaces", ".policy_rollouts", ".recorded_episode",
        ".episode_messages", ".demonstrations",
    )):
        continue
    importlib.import_module(name)
print(surg_sim.__file__, len(found))
runpy.run_module("surg_sim.demo", run_name="__main__", alter_sys=True)
"""


def test_pip_install_and_demo_without_ros(tmp_path: Path) -> None:
    tree, target = tmp_path / "tree", tmp_path / "site"
    no_litter = shutil.ignore_patterns("__pycache__", "*.egg-info", "build")
    for part in ("src/surg_sim", "src/surg_description", "cells"):
        shutil.copytree(paths.ROOT / part, tree / part, ignore=no_litter)
    make = [sys.executable, "setup.py", "--quiet", "sdist", "--dist-dir", str(tmp_path)]
    subprocess.run(make, check=True, timeout=120, capture_output=True, cwd=tree / "src/surg_sim")
    shutil.rmtree(tree)  # the archive builds apart from the tree
    (archive,) = tmp_path.glob("surg_sim-*.tar.gz")
    # The dependencies are the machine's; what is tested is that the package itself is complete.
    install = ["-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    install += ["--no-build-isolation", "--target", str(target), str(archive)]
    subprocess.run([sys.executable, *install], check=True, timeout=120, capture_output=True)
    core.provide(target)
    words = ["--task", "pick_and_place", "--out", str(tmp_path / "out")]
    words += ["--size", "160", "120"] if FULL else ["--no-video"]
    done = subprocess.run(
        [sys.executable, "-c", _USE, *words],
        timeout=300,
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(target), "LD_LIBRARY_PATH": core.libraries()},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    file, count = done.stdout.splitlines()[0].split()
    assert Path(file).is_relative_to(target)
    assert int(count) >= 30
    assert "success" in done.stdout
    assert (tmp_path / "out/pick_and_place_phantom_20000.png").stat().st_size > 10_000
    assert not FULL or list((tmp_path / "out").glob("*.mp4")) + list(
        (tmp_path / "out").glob("*.gif")
    )
    for part in ("cells/sim_ur5e/cell.yaml", "src/surg_description/urdf/ur5e.urdf"):
        assert (target / "surg_sim/data" / part).is_file()


def test_alone_it_names_what_is_missing(tmp_path: Path) -> None:
    shutil.copytree(paths.ROOT / "src/surg_sim", tmp_path / "surg_sim")
    build = [sys.executable, "setup.py", "--quiet", "build"]
    done = subprocess.run(
        build, cwd=tmp_path / "surg_sim", capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert f"needs {tmp_path.parent / 'cells'}" in done.stderr
