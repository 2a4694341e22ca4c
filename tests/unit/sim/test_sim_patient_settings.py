"""The settings: what exists, and that the docs print every value with its source."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import FrozenInstanceError
from math import degrees

import numpy as np
import pytest

from surg_cli.host import paths
from surg_sim.physics.patient_settings import SETTINGS, PatientSetting, find_setting
from surg_sim.physics.sim_arm import DRIVES, ToolError

VALUES: dict[str, Callable[[PatientSetting], float]] = {
    "wall stiffness, N/m": lambda c: c.trocar.stiffness,
    "seal friction, N": lambda c: c.trocar.friction,
    "breathing at the wall, mm": lambda c: 1e3 * c.breathing.amplitude,
    "breathing period, s": lambda c: c.breathing.period,
    "share of it at the bed": lambda c: c.breathing.bed_share,
    "calibration error, tip, mm": lambda c: 1e3 * _error(c).tip,
    "calibration error, axis, °": lambda c: degrees(_error(c).axis),
    "greatest drive lag, ms": lambda _: 1e3 * DRIVES.lag[1],
    "command delay, ticks": lambda _: DRIVES.delay,
    "servo stiffness, N m/rad": lambda _: DRIVES.stiffness,
    "encoder step, µrad": lambda c: 1e6 * c.encoder,
    "tissue stretch stiffness, N": lambda c: c.tissue.stretch,
    "mesentery, N/m per node": lambda c: c.tissue.mesentery,
    "slip force in the jaws, N": lambda c: c.tissue.slip_force,
}


def _error(setting: PatientSetting) -> ToolError:
    return setting.tool_error or ToolError(0.0, 0.0)


def test_the_three_settings() -> None:
    assert list(SETTINGS) == ["phantom", "ex_vivo", "in_vivo"]
    for name in SETTINGS:
        assert find_setting(name).name == name
    with pytest.raises(ValueError, match="no setting 'cadaver': there are phantom, ex_vivo, in"):
        find_setting("cadaver")
    with pytest.raises(FrozenInstanceError):
        find_setting("phantom").encoder = 0.0  # type: ignore[misc]


def test_only_the_living_breathe() -> None:
    R = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # base y is up
    for name, setting in SETTINGS.items():
        wall, bed = setting.breathing.wall(R), setting.breathing.bed()
        if name != "in_vivo":
            assert wall is None and bed is None
            continue
        assert wall is not None and bed is not None
        offset, velocity = wall.at(1.0)
        assert R @ offset == pytest.approx([0, 0, setting.breathing.amplitude])
        assert np.linalg.norm(velocity) < 1e-12
        assert bed.at(1.0)[0] == pytest.approx([0, 0, 0.001])


def test_the_page_has_every_parameter_and_its_source() -> None:
    page = (paths.ROOT / "docs" / "reference" / "simulation.md").read_text("utf-8")
    assert f"| | {' | '.join(SETTINGS)} | source |" in page
    for title, value in VALUES.items():
        row = " | ".join([title, *(f"{value(c):.5g}" for c in SETTINGS.values())])
        (source,) = re.findall(rf"(?m)^\| {re.escape(row)} \| (.*) \|$", page)
        assert "assumed" in source or "et al." in source, title
