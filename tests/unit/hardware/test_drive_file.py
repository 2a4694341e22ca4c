"""A drive's file: what it gives, and every refusal with file, key and value."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import surg_core
from helpers.hardware.servo_bench import DRIVE, JAW, drive_file, emulated_drive_cell
from surg_cli.host import paths
from surg_hardware.drive.coupling import Coupling
from surg_hardware.drive.drive_file import drive_of, load_drive

Edit = Callable[[dict[str, Any]], object]


def motor(joint: str, **changed: object) -> Edit:
    return lambda drive: drive["motors"][joint].update(changed)


def homing(**changed: object) -> Edit:
    return lambda drive: drive["motors"]["yaw"]["homing"].update(changed)


def top(**changed: object) -> Edit:
    return lambda drive: drive.update(changed)


REFUSED: dict[str, tuple[Edit, str, str]] = {
    "two motors with one id": (motor("yaw", id=1), "motors.yaw.id", "pitch"),
    "an id beyond the last": (motor("yaw", id=253), "motors.yaw.id", "253"),
    "a model without a bound of its current": (
        motor("jaw", model="XL430-W250"), "motors.jaw.model", "XL430-W250",
    ),
    "a singular coupling": (
        lambda drive: drive["coupling"].update(yaw=[2, 0, 0]), "coupling", "singular",
    ),
    "a coupling with a row too many": (
        lambda drive: drive["coupling"].update(roll=[0, 0, 0]), "coupling.roll", "known",
    ),
    "a short row": (lambda drive: drive["coupling"].update(yaw=[1, 0]), "coupling.yaw", "2"),
    "limits without zero": (motor("pitch", limits=[0.2, 1.0]), "motors.pitch.limits", "0.2"),
    "limits the wrong way": (motor("pitch", limits=[1.0, -1.0]), "motors.pitch.limits", "1"),
    "more current than the motor has": (motor("jaw", current=4.0), "motors.jaw.current", "4.0"),
    "a homing with more than the bound": (homing(current=0.7), "yaw.homing.current", "0.7"),
    "a direction of none": (homing(direction=0), "yaw.homing.direction", "0"),
    "no stop": (lambda drive: drive["motors"]["yaw"]["homing"].pop("stop"), "stop", "missing"),
    "a stop behind the zero": (homing(stop=0.3), "yaw.homing.stop", "0.3 is behind"),
    "a slow line": (top(baud=57600), "baud", "57600"),
    "an unknown loss": (top(when_lost="close"), "when_lost", "close"),
    "voltages the wrong way": (top(voltage=[13.0, 11.0]), "voltage", "13"),
    "an oven": (top(temperature=200), "temperature", "200"),
    "a drive without jaws": (lambda drive: drive["motors"].pop("jaw"), "motors.jaw", "missing"),
    "an unknown joint": (
        lambda drive: drive["motors"].update(elbow={"id": 9}), "motors.elbow.id", "known",
    ),
    "another format": (top(format="surg_drive/2"), "format", "surg_drive/2"),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_what_must_not_be_used_is_refused_with_file_and_key(what: str, tmp_path: Path) -> None:
    edit, key, value = REFUSED[what]
    document = json.loads(json.dumps(DRIVE))
    edit(document)
    with pytest.raises(surg_core.ConfigError) as caught:
        drive_file(tmp_path, document)
    said = str(caught.value)
    assert key in said and value in said and "drive_PSM1.yaml" in said and "\n" not in said


def test_joints_and_encoders_are_each_others_inverse(tmp_path: Path) -> None:
    """By hand: pitch 0.5, yaw -0.4, jaw 0.7 need motors 0.5, -0.7, 0.32."""
    coupling = Coupling(drive_file(tmp_path), np.array([2.0, -1.0, 5.5]))
    joints = np.array([0.5, -0.4, 0.7])
    encoders = coupling.encoders(joints)
    assert encoders == pytest.approx([2.0 + 0.5, -1.0 - 0.7, 5.5 - 1.5 * 0.32])
    assert coupling.joints(encoders) == pytest.approx(joints)
    assert coupling.rates(np.array([1.0, 0.0, 0.0])) == pytest.approx([1.0, 0.6, 0.2])
    far = coupling.encoders(np.array([9.0, 0.0, -9.0]))
    assert coupling.joints(far) == pytest.approx([1.4, 0.0, 0.0]), "within the limits"


def test_goals_are_taken_by_name(tmp_path: Path) -> None:
    coupling = Coupling(drive_file(tmp_path), np.zeros(3))
    before = np.array([0.1, 0.2, 0.3])
    named = {"jaw": 0.5, "pitch": float("nan"), "elbow": 1.0}
    assert coupling.goal(before, named) == pytest.approx([0.1, 0.2, 0.5])


def test_a_drive_of_the_jaws_alone(tmp_path: Path) -> None:
    document = {**DRIVE, "motors": {"jaw": JAW}, "coupling": {"jaw": [1]}}
    assert drive_file(tmp_path, document).joints == ("jaw",)


def test_the_drive_must_reach_the_instruments_jaws(tmp_path: Path) -> None:
    cell = surg_core.load_cell(emulated_drive_cell(tmp_path))
    assert drive_of(cell, "PSM1").joints == ("pitch", "yaw", "jaw")
    document = json.loads(json.dumps(DRIVE))
    document["motors"]["jaw"]["limits"] = [0.0, 0.5]
    drive_file(cell.folder, document)
    with pytest.raises(surg_core.ConfigError, match=r"motors\.jaw\.limits.*\[0, 0\.7\] rad"):
        drive_of(cell, "PSM1")
    (cell.folder / "drive_PSM1.yaml").unlink()
    with pytest.raises(surg_core.ConfigError, match=r"drive_PSM1\.yaml"):
        drive_of(cell, "PSM1")


def test_the_drive_must_have_the_motors_of_the_instruments_wrist(tmp_path: Path) -> None:
    file = "drive_PSM1.yaml"
    folder = tmp_path / "cells" / "wristed"
    shutil.copytree(paths.CELLS / "emulated_ur5e_wrist", folder)
    (tmp_path / "src").symlink_to(paths.ROOT / "src")
    cell = surg_core.load_cell(folder)
    assert drive_of(cell, "PSM1").joints == ("pitch", "yaw", "jaw", "roll")
    text = (folder / file).read_text("utf-8")
    (folder / file).write_text(text.replace("[-4.5, 4.5]", "[-3.0, 4.5]"), "utf-8")
    with pytest.raises(surg_core.ConfigError, match=r"motors\.roll\.limits.*\[-4\.5, 4\.5\] rad"):
        drive_of(cell, "PSM1")
    drive_file(folder)  # three motors
    with pytest.raises(surg_core.ConfigError, match=r"motors: pitch, yaw, jaw; .*yaw, jaw, roll"):
        drive_of(cell, "PSM1")


def test_a_cell_whose_arm_has_no_drive_is_told(tmp_path: Path) -> None:
    cell = surg_core.load_cell(paths.CELLS / "emulated_ur5e")
    with pytest.raises(surg_core.ConfigError, match=r"cell\.yaml.*tool_link: is not 'drive'"):
        drive_of(cell, "PSM1")


def test_the_file_in_the_guide_is_valid(tmp_path: Path) -> None:
    page = (paths.ROOT / "docs" / "guide" / "build_a_drive.md").read_text("utf-8")
    path = tmp_path / "drive_PSM1.yaml"
    path.write_text(page.split("```yaml\n")[1].split("```")[0], "utf-8")
    assert load_drive(path).joints == ("jaw",)
