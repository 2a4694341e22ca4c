"""The settings: what exists, that everything has a source, and that the docs print it."""

from __future__ import annotations

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from surg_cli.host import paths
from surg_sim.physics.patient_settings import SETTINGS, SOURCES, find_setting, table


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
