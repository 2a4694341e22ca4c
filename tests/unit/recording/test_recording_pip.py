"""The library installs by pip and works where there is no ROS."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from helpers.tree import installed_core as core

PACKAGE = Path(__file__).parents[3] / "src" / "surg_recording"
TEMPLATES = PACKAGE / "src" / "surg_recording" / "reports" / "templates"

_USE = """
import importlib, pkgutil, sys
HIDDEN = {"rospy", "rosgraph", "genpy", "surg_msgs", "crtk_msgs", "surg_ros"}
class NoRos:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in HIDDEN:
            raise ImportError(f"{name} is not there")
sys.meta_path.insert(0, NoRos())
import surg_recording
found = [m.name for m in pkgutil.walk_packages(surg_recording.__path__, "surg_recording.")]
for name in found:
    if not (name.endswith("_node") or ".nodes." in name):
        importlib.import_module(name)
print(surg_recording.__file__, len(found))
"""


def test_pip_install_without_ros(tmp_path: Path) -> None:
    source, target = tmp_path / "source", tmp_path / "site"
    shutil.copytree(PACKAGE, source, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    # The dependencies are the machine's; what is tested is that the package itself is complete.
    install = ["-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    install += ["--no-build-isolation", "--target", str(target), str(source)]
    subprocess.run([sys.executable, *install], check=True, timeout=120, capture_output=True)
    core.provide(target)
    done = subprocess.run(
        [sys.executable, "-c", _USE],
        check=True,
        timeout=60,
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(target), "LD_LIBRARY_PATH": core.libraries()},
    )
    file, count = done.stdout.split()
    assert Path(file).is_relative_to(target)
    assert int(count) >= 80
    templates = [f"reports/templates/{each.name}" for each in TEMPLATES.iterdir()]
    for data in ("py.typed", *templates):
        assert (target / "surg_recording" / data).exists()
