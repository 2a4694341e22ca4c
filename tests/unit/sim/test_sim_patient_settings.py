"""The settings: what exists, that everything has a source, and that the docs print it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import FrozenInstanceError
from math import degrees

import numpy as np
import pytest

from surg_cli.host import paths
from surg_sim.physics.patient_settings import SETTINGS, SOURCES, PatientSetting, find_setting
from surg_sim.physics.sim_arm import ToolError


def table() -> str:
    """The settings as a Markdown table, for docs/reference/simulation.md."""
    rows: list[tuple[str, str, Callable[[PatientSetting], float]]] = [
        ("wall stiffness, N/m", "wall stiffness", lambda c: c.trocar.stiffness),
        ("seal friction, N", "seal friction", lambda c: c.trocar.friction),
        ("breathing at the wall, mm", "breathing amplitude", lambda c: 1e3 * c.breathing.amplitude),
        ("breathing period, s", "breathing period", lambda c: c.breathing.period),
        ("share of it at the bed", "bed share", lambda c: c.breathing.bed_share),
        ("calibration error, tip, mm", "calibration error", lambda c: 1e3 * _error(c).tip),
        ("calibration error, axis, °", "calibration error", lambda c: degrees(_error(c).axis)),
        ("drive lag, ms", "drives", lambda c: 1e3 * c.actuators.lag),
        ("command delay, ticks", "drives", lambda c: c.actuators.delay),
        ("servo stiffness, N m/rad", "drives", lambda c: c.actuators.stiffness),
        ("encoder step, µrad", "encoder", lambda c: 1e6 * c.encoder),
        ("tissue stretch stiffness, N", "tissue stretch stiffness", lambda c: c.tissue.stretch),
        ("mesentery, N/m per node", "mesentery stiffness", lambda c: c.tissue.mesentery),
        ("slip force in the jaws, N", "slip force", lambda c: c.tissue.slip_force),
    ]
    lines = [f"| | {' | '.join(SETTINGS)} | source |", "|" + "---|" * (len(SETTINGS) + 2)]
    for title, source, value in rows:
        values = " | ".join(f"{value(c):.5g}" for c in SETTINGS.values())
        lines.append(f"| {title} | {values} | {SOURCES[source]} |")
    return "\n".join(lines)


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


def test_every_parameter_has_a_source_and_the_docs_print_them() -> None:
    for text in SOURCES.values():
        assert "assumed" in text or "et al." in text
    page = (paths.ROOT / "docs" / "reference" / "simulation.md").read_text("utf-8")
    assert table() in page, (
        "docs/reference/simulation.md, 'Physics and settings': put conditions.table() in"
    )
