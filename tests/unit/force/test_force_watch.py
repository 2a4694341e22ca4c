"""What the guards are told by the watch of a sensor: a force, or why it is not known."""

import datetime
from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.force import sensed_cell
from helpers.force.force_bench import ForceBench
from helpers.force.statics import Array
from surg_hardware.force.force_watch import SILENT_S, ForceWatch

NOW = datetime.datetime.now(datetime.UTC)
PERIOD = 0.002


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The cell sim_ur5e with a calibrated sensor."""
    return sensed_cell.write(tmp_path)


class Fed:
    """A watch of an arm at home, with readings of the free tool."""

    def __init__(self, folder: Path) -> None:
        cell = surg_core.load_cell(folder)
        self.watch = ForceWatch(cell, "PSM1", NOW)
        self.q = np.array(cell.arms["PSM1"].robot.home)
        self.free = ForceBench(cell, "PSM1", 5).reading(self.q)
        self.t = 0.0

    def feed(self, n: int = 12, reading: Array | None = None, joints: bool = True) -> str:
        for _ in range(n):
            self.t += PERIOD
            if joints:
                self.watch.joints(self.t, self.q, np.zeros(6))
            self.watch.reading(self.t, self.t, self.free if reading is None else reading)
        return self.watch.tell(self.t).reason


def test_a_good_sensor_is_told_with_both_forces_in_the_base(folder: Path) -> None:
    fed = Fed(folder)
    assert fed.watch.tell(0.0).reason == "silent"
    assert fed.feed(4) == "filling"
    assert fed.feed() == "ok"
    told = fed.watch.tell(fed.t)
    assert told.tip is not None and told.trocar is not None
    assert np.linalg.norm(told.tip) < 0.1 and np.linalg.norm(told.trocar) < 0.1
    assert 0.0 < fed.t - told.stamp <= 0.010


def test_bad_input_is_named_and_never_told_as_a_force(folder: Path) -> None:
    fed = Fed(folder)
    assert fed.feed() == "ok"
    late = fed.watch.tell(fed.t + SILENT_S + 0.001)
    assert (late.reason, late.tip, late.trocar) == ("silent", None, None)
    saturated, broken = fed.free.copy(), fed.free.copy()
    saturated[2], broken[4] = 200.0, np.nan
    for bad, reason in ((saturated, "saturated"), (broken, "not_finite")):
        assert fed.feed(1, bad) == reason
        assert fed.watch.tell(fed.t).tip is None
        assert fed.feed(1) == "filling"
        assert fed.feed() == "ok"
    fed.t += SILENT_S
    assert fed.feed(3, joints=False) == "no_joints"


def test_a_calibration_older_than_the_tool_is_told_until_the_old_tool_is_back(
    folder: Path,
) -> None:
    fed = Fed(folder)
    assert fed.feed() == "ok"
    other = folder / "calibration" / "tool_long.yaml"
    other.write_text("another tool\n", encoding="utf-8")
    fed.watch.mount(other)
    assert fed.feed() == "stale"
    told = fed.watch.tell(fed.t)
    assert told.tip is None and "Repeat ./surg calibrate CELL force" in told.sentence
    fed.watch.mount(folder / "calibration" / "tool_PSM1.yaml")
    assert fed.feed() == "ok"
    sensor = folder / "force_sensor_PSM1.yaml"
    sensor.write_text(sensor.read_text("utf-8") + "# changed\n", encoding="utf-8")
    assert Fed(folder).feed() == "stale"


def test_near_the_trocar_no_force_is_told(folder: Path) -> None:
    fed = Fed(folder)
    assert fed.feed() == "ok"
    X = fed.watch._arm.chain.forward(fed.q)
    tip = (X @ np.array([*fed.watch._arm.tool.p_FTip, 1.0]))[:3]
    fed.watch.trocar(tip - 0.008 * X[:3, :3] @ fed.watch._arm.tool.s_F)
    assert fed.feed() == "near_trocar"


def test_a_cell_without_sensor_or_calibration_is_refused_by_the_missing_file(folder: Path) -> None:
    (folder / "calibration" / "force_PSM1.yaml").unlink()
    with pytest.raises(surg_core.ConfigError, match="force_PSM1"):
        ForceWatch(surg_core.load_cell(folder), "PSM1", NOW)
    (folder / "force_sensor_PSM1.yaml").unlink()
    with pytest.raises(surg_core.ConfigError, match="force_sensor_PSM1"):
        ForceWatch(surg_core.load_cell(folder), "PSM1", NOW)
