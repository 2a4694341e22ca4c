"""`hardware:` in a cell: what it gives the link, and every refusal with file, key and value."""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import surg_core
from helpers.hardware.emulated_cell import emulated_cell
from surg_cli.commands import up
from surg_cli.graph import system
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.host import paths
from surg_hardware import link_node
from surg_hardware.franka.franka_adapter import FrankaAdapter
from surg_hardware.franka.joint_limits import FR3, PANDA

BUNDLED = paths.CELLS / "emulated_ur5e"
Edit = Callable[[dict[str, Any]], object]


def written(folder: Path, edit: Edit) -> Path:
    """A copy of the bundled cell with its arm PSM1 edited; returns its cell.yaml."""
    return emulated_cell(folder, edit=edit) / "cell.yaml"


def test_the_driver_gets_what_cell_and_link_state() -> None:
    arm = surg_core.load_cell(BUNDLED).arms["PSM1"]
    settings = link_node.driver_settings(arm)
    assert settings.address == "127.0.0.1" and arm.hardware.emulated
    assert settings.velocity == tuple(arm.robot.velocity)
    assert settings.acceleration == pytest.approx([40.0] * 6)
    assert (settings.dead_man, settings.stop_deceleration) == (0.04, 20.0)
    assert arm.robot.tuning.link_timeout == 0.04


@pytest.mark.parametrize("name", ["fr3", "panda"])
def test_the_bundled_franka_cells_state_all_that_the_driver_needs(name: str) -> None:
    arm = surg_core.load_cell(paths.CELLS / f"emulated_{name}").arms["PSM1"]
    settings = link_node.driver_settings(arm)
    assert settings.driver == name and arm.hardware.emulated
    limits = {"fr3": FR3, "panda": PANDA}[name]
    assert settings.acceleration == pytest.approx([joint.acceleration for joint in limits])
    assert settings.stop_deceleration < min(settings.acceleration)
    assert all(u <= j.velocity for u, j in zip(settings.velocity, limits, strict=True))
    assert arm.robot.tuning.link_timeout == 0.04 and settings.dead_man == 0.02
    FrankaSettings(settings.address, settings.options)
    home = arm.chain.forward(arm.robot.home)
    away = arm.trocar.p_BRcm - home[:3, 3]
    s = home[:3, :3] @ arm.tool.s_F
    p = home[:3, :3] @ arm.tool.p_FTip
    assert np.linalg.norm(np.cross(away - p, s)) < 1e-9, "the trocar is on the shaft at home"


class FrankaSettings(FrankaAdapter):
    """Checks a link's settings, without a library."""

    limits = PANDA
    _begin = _read = _write = connect = close = None  # type: ignore[assignment]


def test_up_starts_the_link_and_no_simulator() -> None:
    plan = SystemPlan(BUNDLED, ("PSM1",), False, (), Path("out"), simulated=(), driven=("PSM1",))
    nodes = {node.name: node for node in system.nodes(plan)}
    assert nodes["/PSM1/link"].package == "surg_hardware" and "/sim" not in nodes


def test_up_says_that_the_arm_is_emulated(capsys: pytest.CaptureFixture[str]) -> None:
    up.describe_arms(surg_core.load_cell(BUNDLED).arms)
    assert "emulated, at 127.0.0.1" in capsys.readouterr().out


def hardware(**changed: object) -> Edit:
    return lambda arm: arm["hardware"].update(changed)


def without(key: str) -> Edit:
    return lambda arm: arm["hardware"].pop(key)


REFUSED: dict[str, tuple[Edit, str, str]] = {
    "a public address": (hardware(address="8.8.8.8"), "hardware.address", "8.8.8.8"),
    "a name": (hardware(address="robot.local"), "hardware.address", "robot.local"),
    "no address": (without("address"), "hardware.address", "missing"),
    "no serial": (without("serial"), "hardware.serial", "missing"),
    "an empty serial": (hardware(serial=""), "hardware.serial", "empty"),
    "no payload": (without("payload"), "hardware.payload.mass", "missing"),
    "a heavy payload": (
        hardware(payload={"mass": 30.0, "cog": [0.0, 0.0, 0.0]}), "hardware.payload.mass", "30",
    ),
    "a far payload": (
        hardware(payload={"mass": 1.0, "cog": [0.0, 0.0, 0.6]}), "hardware.payload.cog", "0.6",
    ),
    "no tool link": (without("tool_link"), "hardware.tool_link", "missing"),
    "an unknown tool link": (hardware(tool_link="active"), "hardware.tool_link", "active"),
    "no priority": (without("realtime"), "hardware.realtime", "missing"),
    "a priority of the kernel": (hardware(realtime=99), "hardware.realtime", "99"),
    "an unknown key": (hardware(password="x"), "hardware.password", "known"),
    "no hardware": (lambda arm: arm.pop("hardware"), "arms.PSM1.hardware", "missing"),
    "hardware of a simulator": (
        lambda arm: arm.update(link="simulator"), "arms.PSM1.hardware", "'simulator'",
    ),
    "a link's YAML that is not there": (
        lambda arm: arm.update(link="own.yaml"), "arms.PSM1.link", "'own.yaml'",
    ),
    "an unknown link": (lambda arm: arm.update(link="kuka"), "arms.PSM1.link", "'kuka'"),
    "a driven instrument": (
        lambda arm: arm.update(instrument=arm["instrument"].replace("grasper_fixed", "grasper")),
        "hardware.tool_link", "'passive'",
    ),
    "a passive instrument": (hardware(tool_link="none"), "hardware.tool_link", "'none'"),
    "a drive for a passive instrument": (
        hardware(tool_link="drive"), "hardware.tool_link", "'drive'",
    ),
    "seven joints": (
        lambda arm: arm.update(robot=arm["robot"].replace("ur5e", "panda")), "arms.PSM1.link", "7",
    ),
    "a Panda's library for an FR3": (
        lambda arm: arm.update(robot=arm["robot"].replace("ur5e", "fr3"), link="panda"),
        "arms.PSM1.link", "'fr3'",
    ),
    "an FR3's library for a Panda": (
        lambda arm: arm.update(robot=arm["robot"].replace("ur5e", "panda"), link="fr3"),
        "arms.PSM1.link", "'panda'",
    ),
    "a real arm with a computed calibration": (
        hardware(address="192.168.56.2"), "arms.PSM1.hardware", "computed",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_what_must_not_be_used_is_refused_with_file_and_key(what: str, tmp_path: Path) -> None:
    edit, key, value = REFUSED[what]
    file = written(tmp_path, edit)
    with pytest.raises(surg_core.ConfigError) as caught:
        surg_core.load_cell(file)
    assert key in str(caught.value) and value in str(caught.value)
    assert str(file) in str(caught.value)


def real_cell(folder: Path, edit: Edit = lambda arm: None) -> Path:
    """The cell of a real arm, calibrated and confirmed, then edited."""

    def make(arm: dict[str, Any]) -> None:
        arm["hardware"].update(
            address="192.168.56.2", calibration_days=30, link_lag=0.0101, home_confirmed=True
        )
        edit(arm)

    file = written(folder, make)
    today = datetime.date.today().isoformat()
    for what in ("tool", "trocar"):
        calibration = file.parent / "calibration" / f"{what}_PSM1.yaml"
        text = calibration.read_text("utf-8").replace("source: computed", "source: measured")
        text = re.sub("date: .*", f'date: "{today}"\nserial: "20225500001"', text)
        calibration.write_text(text, "utf-8")
    return file


BAD_CALIBRATIONS: dict[str, tuple[str, str, str, str, str]] = {
    "a simulated tool": ("tool", "measured", "simulated", "hardware", "simulated"),
    "a computed trocar": ("trocar", "measured", "computed", "hardware", "trocar"),
    "another arm's tool": ("tool", "20225500001", "77", "hardware.serial", "'77'"),
    "no arm's trocar": ("trocar", "serial: .*\n", "", "hardware.serial", "an unknown arm"),
    "an old tool": ("tool", "date: .*", "date: x2026-01-31x", "calibration_days", "days ago"),
    "a future tool": ("tool", "date: .*", "date: x2999-01-31x", "calibration_days", "2999"),
    "no day": ("tool", "date: .*", "date: x2026-02-31x", "calibration_days", "no date"),
}
"""What is wrong -> file, its text, the text instead, the key that is named, and a word."""
BAD_HARDWARE: dict[str, tuple[Edit, str, str]] = {
    "no longest age": (without("calibration_days"), "calibration_days", "missing"),
    "an endless age": (hardware(calibration_days=1000), "calibration_days", "366"),
    "the emulator's lag": (without("link_lag"), "link_lag", "robot CELL lag"),
    "a lag that no link has": (hardware(link_lag=0.3), "link_lag", "0.3"),
    "five lags for six joints": (hardware(link_lag=[0.01] * 5), "link_lag", "has 5 values"),
    "lags of nine joints": (hardware(link_lag=[0.01] * 9), "link_lag", "has 9 values"),
    "no lags": (hardware(link_lag=[]), "link_lag", "has 0 values"),
    "a negative lag": (hardware(link_lag=[0.01] * 5 + [-0.001]), "link_lag", "value 6, -0.001"),
    "a long lag": (hardware(link_lag=[0.01, 0.06, *[0.01] * 4]), "link_lag", "value 2, 0.06"),
    "a lag that is no number": (hardware(link_lag=[0.01] * 5 + ["x"]), "link_lag", "number"),
    "a lag that is not finite": (hardware(link_lag=[0.01] * 5 + [math.inf]), "link_lag", "inf"),
    "a home that nobody has seen": (
        hardware(home_confirmed=False), "home_confirmed", "nobody has seen",
    ),
}  # fmt: skip


def test_a_calibrated_and_confirmed_real_arm_is_accepted(tmp_path: Path) -> None:
    arm = surg_core.load_cell(real_cell(tmp_path)).arms["PSM1"]
    assert not arm.hardware.emulated
    assert arm.robot.tuning.link_lag == 0.0101, "the arm's own lag, not the emulator's"
    lags = [0.0081, 0.0092, 0.0087, 0.0104, 0.0115, 0.0098]
    each = surg_core.load_cell(real_cell(tmp_path / "each", hardware(link_lag=lags))).arms["PSM1"]
    assert each.robot.joint_lag.tolist() == lags and each.robot.tuning.link_lag == max(lags)


@pytest.mark.parametrize("what", [*BAD_CALIBRATIONS, *BAD_HARDWARE])
def test_what_a_real_arm_must_not_use_is_refused_with_its_key(what: str, tmp_path: Path) -> None:
    if what in BAD_HARDWARE:
        edit, key, word = BAD_HARDWARE[what]
        file = real_cell(tmp_path, edit)
    else:
        name, old, new, key, word = BAD_CALIBRATIONS[what]
        file = real_cell(tmp_path)
        calibration = file.parent / "calibration" / f"{name}_PSM1.yaml"
        text = re.sub(old, new.replace("x", '"'), calibration.read_text("utf-8"))
        calibration.write_text(text, "utf-8")
    with pytest.raises(surg_core.ConfigError) as caught:
        surg_core.load_cell(file)
    said = str(caught.value)
    assert "arms.PSM1.hardware" in said and key in said and word in said and str(file) in said


def test_a_tool_of_another_instrument_is_refused(tmp_path: Path) -> None:
    """Its tip is elsewhere than the instrument's drawing says; a clamp is some mm off."""
    for off, wrong in ((0.018, False), (0.022, True)):
        file = real_cell(tmp_path / str(off))
        tool = file.parent / "calibration" / "tool_PSM1.yaml"
        text = re.sub("tip: .*", f"tip: [0.06, 0.0, {0.3 + off}]", tool.read_text("utf-8"))
        tool.write_text(text, "utf-8")
        if not wrong:
            surg_core.load_cell(file)
            continue
        with pytest.raises(surg_core.ConfigError, match=r"22 mm from .*grasper_fixed") as it:
            surg_core.load_cell(file)
        assert "arms.PSM1.hardware" in str(it.value) and str(tool) in str(it.value)


def test_a_real_arm_that_is_being_commissioned_moves_slowly(tmp_path: Path) -> None:
    """Nothing is calibrated yet: it can be measured, at 20 mm/s."""
    file = written(tmp_path, hardware(address="192.168.56.2", commissioning=True))
    arm = surg_core.load_cell(file).arms["PSM1"]
    assert (arm.limits.tip_velocity, arm.limits.flange_velocity) == (0.02, 0.05)
    bundled = surg_core.load_cell(BUNDLED).arms["PSM1"].limits
    assert bundled.tip_velocity > 0.02 and bundled.flange_velocity > 0.05


def test_a_robot_has_one_arm(tmp_path: Path) -> None:
    file = written(tmp_path, lambda arm: None)
    document = yaml.safe_load(file.read_text("utf-8"))
    for key, other in (("address", "127.0.0.9"), ("serial", "other")):
        arm = yaml.safe_load(yaml.safe_dump(document["arms"]["PSM1"]))
        arm["hardware"][key] = other
        both = {**document, "arms": {"PSM1": document["arms"]["PSM1"], "PSM2": arm}}
        file.write_text(yaml.safe_dump(both), "utf-8")
        with pytest.raises(surg_core.ConfigError, match=r"arms\.PSM2\.hardware\.(serial|address)"):
            surg_core.load_cell(file)
