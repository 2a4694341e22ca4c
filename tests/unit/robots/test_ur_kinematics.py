"""An arm's own kinematics: read from its controller, checked, written, and in everybody's chain."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.hardware import emulated_ur
from helpers.hardware.emulated_cell import HOME, SERIAL, emulated_cell
from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_cli.robots import robot_doctor
from surg_core import calibration
from surg_core.urdf import chain_from_urdf
from surg_emulators.ur.dh_kinematics import TABLES, Table, frames, pose_vector
from surg_emulators.ur.primary_server import PrimarySession
from surg_emulators.ur.ur_controller import UrController
from surg_hardware.identity import flange_difference, ur_flange
from surg_hardware.ur import primary

ROBOT = surg_core.load_robot(paths.ROOT / "src/surg_description/robots/ur5e.yaml")
URDF = paths.ROOT / "src/surg_description/robots" / ROBOT.urdf
DRAWN = chain_from_urdf(URDF, ROBOT.base_link, ROBOT.flange_link, ROBOT.joint_names)
Rows = list[tuple[float, float, float]]


def errors(seed: int, millimetres: float = 1.0) -> Rows:
    """A calibration as arms have it: corrections of d, a [m] and alpha [rad] of each joint."""
    draw = random.Random(seed).uniform
    m = 1e-3 * millimetres
    return [(draw(-m, m), draw(-m, m), draw(-1e-3, 1e-3)) for _ in range(6)]


def own(theta: list[float], table: Table) -> surg_core.Chain:
    d, a, alpha = (list(column) for column in zip(*table, strict=True))
    rows = {"theta": theta, "d": d, "a": a, "alpha": alpha}
    text = calibration.kinematics_text("ur5e", SERIAL, "2026-11-23", rows)
    return surg_core.with_kinematics(DRAWN, surg_core.kinematics_of(text, "k.yaml"))


def test_the_chain_is_that_of_the_arms_own_parameters() -> None:
    """50 arms, 20 postures each, against the emulator's kinematics, which share no code."""
    rng = np.random.default_rng(3)
    worst, largest = 0.0, 0.0
    for seed in range(50):
        table = UrController(dh_errors=errors(seed)).table
        chain = own([0.0] * 6, table)
        for q in rng.uniform(-3.0, 3.0, (20, 6)):
            theirs = ur_flange(pose_vector(frames(q, table)[-1]), [0.0] * 6)
            worst = max(worst, *flange_difference(chain.forward(q), theirs))
            largest = max(largest, flange_difference(DRAWN.forward(q), theirs)[0])
    print(f"50 arms: {worst:.1e} m or rad; the drawing is up to {1e3 * largest:.1f} mm wrong")
    assert worst < 1e-9
    assert largest > 0.002


def test_joint_frames_stay_near_the_drawings() -> None:
    """The clearance guard's capsules are stated in them."""
    chain = own([0.0] * 6, UrController(dh_errors=errors(4)).table)
    X_drawn, X_own = np.eye(4), np.eye(4)
    for drawn, joint in zip(DRAWN.joints, chain.joints, strict=True):
        X_drawn, X_own = X_drawn @ drawn.X_PJ, X_own @ joint.X_PJ
        distance, angle = flange_difference(X_drawn, X_own)
        assert distance < 0.005 and angle < 0.01
        np.testing.assert_array_equal(drawn.axis, joint.axis)


def test_nearly_parallel_axes_with_hundreds_of_metres_are_one_of_two_ways_to_say_it() -> None:
    """Axes 2 and 3 tilted by 0.1 mrad: their common normal is far away.

    The table states d2 = s, d3 = -s with a tilt between them. Moving back along the tilted axis
    shifts the elbow by s * sin(tilt) across the arm, which a2 and theta take up.
    """
    s, tilt = 300.0, 1e-4
    across = s * math.sin(tilt)  # 30 mm, along y of frame 2
    nominal = [list(row) for row in TABLES["UR5e"]]
    length = nominal[1][1]
    turn = math.asin(across / -length)
    nominal[1] = [s, length * math.cos(turn), tilt]
    nominal[2][0] = -s / math.cos(tilt)
    table = [tuple(row) for row in nominal]
    theta = [0.0, turn, -turn, 0.0, 0.0, 0.0]
    chain = own(theta, table)  # type: ignore[arg-type]
    rng = np.random.default_rng(5)
    for q in rng.uniform(-3.0, 3.0, (50, 6)):
        theirs = ur_flange(pose_vector(frames(q + theta, table)[-1]), [0.0] * 6)  # type: ignore[arg-type]
        assert flange_difference(chain.forward(q), theirs)[0] < 1e-9
        assert flange_difference(chain.forward(q), DRAWN.forward(q))[0] < 0.005


def test_another_models_kinematics_are_refused() -> None:
    with pytest.raises(ValueError, match="another model"):
        own([0.0] * 6, TABLES["UR10e"])


def test_the_primary_interface_states_them() -> None:
    controller = UrController(dh_errors=errors(7))
    found = primary.kinematics_in(PrimarySession(controller, "primary").state()[5:])
    assert found is not None
    assert list(zip(found.d, found.a, found.alpha, strict=True)) == controller.table


def test_nonsense_on_the_primary_interface_ends_in_nothing() -> None:
    good = PrimarySession(UrController(), "primary").state()[5:]
    draw = random.Random(1)
    found = 0
    for _ in range(5000):
        data = bytearray(good[: draw.randrange(len(good))])
        for _ in range(draw.randrange(8)):
            if data:
                data[draw.randrange(len(data))] = draw.randrange(256)
        found += primary.kinematics_in(bytes(data)) is not None
    print(f"5000 mangled messages, {found} still whole")
    assert primary.kinematics_in(b"\0\0\0\0\5") is None


def test_the_command_writes_them_and_the_arm_is_accepted(
    surg: Callable[..., int],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(robot_doctor, "MEASURED_S", 0.05)
    controller = UrController(serial=SERIAL, q=HOME, dh_errors=errors(11, 3.0))
    with emulated_ur.in_process(controller) as emulator:
        cell = emulated_cell(tmp_path, emulator.address)
        assert surg("robot", str(cell), "doctor") == 1
        assert f"./surg robot {cell.name} kinematics" in capsys.readouterr().out
        assert surg("robot", str(cell), "kinematics") == 0
        assert surg("robot", str(cell), "doctor") == 0
        controller.serial = "77"
        with pytest.raises(CliError, match=r"hardware\.serial") as problem:
            surg("robot", str(cell), "kinematics")
        assert problem.value.code == 2
    arm = surg_core.load_cell(cell).arms["PSM1"]
    assert arm.kinematics is not None and arm.kinematics.serial == SERIAL
    theirs = ur_flange(pose_vector(frames(HOME, controller.table)[-1]), [0.0] * 6)
    assert flange_difference(arm.chain.forward(HOME), theirs)[0] < 1e-9
    assert flange_difference(DRAWN.forward(HOME), theirs)[0] > 0.001


def test_kinematics_of_another_arm_are_refused_with_file_and_key(tmp_path: Path) -> None:
    cell = emulated_cell(tmp_path, "127.0.0.1")
    rows = {name: [0.0] * 6 for name in ("theta", "d", "a", "alpha")}
    file = cell / "calibration" / "kinematics_PSM1.yaml"
    for serial, model, key in (("77", "ur5e", "serial"), (SERIAL, "ur10e", "model")):
        file.write_text(calibration.kinematics_text(model, serial, "2026-11-23", rows))
        with pytest.raises(surg_core.ConfigError, match=f"{file}: {key}: "):
            surg_core.load_cell(cell)
    file.write_text(calibration.kinematics_text("ur5e", SERIAL, "2026-11-23", rows))
    with pytest.raises(surg_core.ConfigError, match="another model"):
        surg_core.load_cell(cell)
