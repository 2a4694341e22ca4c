"""`./surg dev bench control` without a network: the C++ part with our own laws, and its tables."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "benchmarks" / "control"))

import bench_scene  # noqa: E402

from conftest import FULL  # noqa: E402

OWN = {"exact", "velocity", "paper", "limited", "limited_preview"}


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    build = tmp_path_factory.mktemp("bench_control")
    built = ROOT / "devel" / "lib" / "libsurg_core.so"
    core = [f"-DBENCH_CORE={built}"] if built.exists() else []
    core += [] if FULL else ["-DCMAKE_BUILD_TYPE=Debug"]  # what is asked here is what it computes
    for argv in (
        ["cmake", "-S", str(ROOT / "benchmarks" / "control"), "-B", str(build), *core],
        ["cmake", "--build", str(build), "--parallel", "2"],
    ):
        done = subprocess.run(argv, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return build / "bench_control"


@pytest.mark.skipif(not FULL, reason="compiles a program more; SURG_TEST_FULL=1 runs it")
@pytest.mark.parametrize("tremor", ["0", "10"])
def test_whole_cycles_are_timed(tmp_path_factory: pytest.TempPathFactory, tremor: str) -> None:
    build = tmp_path_factory.getbasetemp() / "bench_cycle"
    devel = ROOT / "devel"
    options = [f"-DBENCH_CORE={devel}/lib/libsurg_core.so", f"-DBENCH_DEVEL={devel}"]
    source = str(ROOT / "benchmarks" / "control")
    for argv in (
        ["cmake", "-S", source, "-B", str(build), *options],
        ["cmake", "--build", str(build), "--target", "bench_cycle"],
    ):
        subprocess.run(argv, capture_output=True, check=True)
    argv = [str(build / "bench_cycle"), str(ROOT / "cells" / "sim_ur5e"), tremor, "5000"]
    told = json.loads(subprocess.run(argv, capture_output=True, text=True, check=True).stdout)
    assert told["cycles"] == 5000
    assert 0 < told["median"] <= told["p99"]


def laws(program: Path, robot: str, folder: Path) -> dict[str, Any]:
    arm = bench_scene.load_arm(ROOT / "cells" / f"sim_{robot}")
    bench_scene.write(arm, 4.0, folder)
    done = subprocess.run(
        [str(program), "laws", str(folder / "arm.txt"), str(folder / "tip.path")],
        capture_output=True,
        text=True,
        check=True,
    )
    result = json.loads(done.stdout)
    assert result["cycles"] == 2000
    return dict(result["laws"])


@pytest.mark.full
@pytest.mark.parametrize("robot", ["ur5e", "panda"])
def test_every_law_makes_the_motion(program: Path, robot: str, tmp_path: Path) -> None:
    told = laws(program, robot, tmp_path)
    assert set(told) >= OWN
    for name in ("exact", "limited", "limited_preview"):
        assert told[name]["rcm_max_at_samples_um"] < 1e-4, name
        assert told[name]["tip_max_um"] < 1e-3, name
    assert told["velocity"]["rcm_max_at_samples_um"] < 5
    for name, law in told.items():
        # The paper's law has no feedback and drifts; nothing else may leave tip or pivot.
        if name != "paper":
            assert law["tip_max_um"] < 50 and law["rcm_max_at_samples_um"] < 50, name
        assert 0 < law["median"] <= law["p99"]


def test_the_path_begins_at_home_and_at_rest() -> None:
    arm = bench_scene.load_arm(ROOT / "cells" / "sim_ur5e")
    path = bench_scene.lissajous(arm, 20.0)
    X_BF = np.asarray(arm.chain.forward(arm.robot.home))
    assert np.allclose(path[0], X_BF[:3, :3] @ arm.tool.p_FTip + X_BF[:3, 3])
    speed = np.linalg.norm(np.diff(path, axis=0), axis=1) / bench_scene.PERIOD
    assert speed[0] < 1e-4 and 0.04 < speed.max() < 0.1
    depth = np.linalg.norm(path - np.asarray(arm.trocar.p_BRcm), axis=1)
    assert depth.min() > 0.09 and depth.max() < 0.15
