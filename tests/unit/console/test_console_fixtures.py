"""Virtual fixtures on the page: positions in the trocar's frame, distances as the controller's."""

from __future__ import annotations

import numpy as np
import pytest

from surg_console.session.fixture_view import FixtureView, region_of
from surg_core.transforms import rpy_to_matrix


def test_the_page_gets_regions_and_tip_in_the_trocars_frame() -> None:
    X_BR = np.eye(4)
    X_BR[:3, :3] = rpy_to_matrix([0.3, 0.8, -1.2])
    X_BR[:3, 3] = [0.4, -0.1, 0.2]

    def in_B(p_R: list[float]) -> np.ndarray:
        return X_BR[:3, :3] @ p_R + X_BR[:3, 3]

    zero = np.zeros(3)
    ball = region_of(
        "ball", "sphere", "keep_out", "tip",
        point=in_B([0.02, 0.0, 0.12]), normal=zero, end=zero, radius=0.005,
    )  # fmt: skip
    vessel = region_of(
        "vessel", "capsule", "keep_out", "shaft",
        point=in_B([0.01, -0.03, 0.06]), normal=zero, end=in_B([0.01, 0.03, 0.06]), radius=0.004,
    )  # fmt: skip
    floor = region_of(
        "floor", "plane", "stay_in", "tip",
        point=in_B([0.0, 0.0, 0.15]), normal=X_BR[:3, :3] @ [0, 0, -1], end=zero, radius=0.0,
    )  # fmt: skip
    page = FixtureView([ball, vessel, floor], in_B([0.0, 0.0, 0.12]), X_BR).as_json()
    assert page["tip"] == pytest.approx([0.0, 0.0, 0.12])
    seen = {region["name"]: region for region in page["regions"]}
    assert seen["ball"]["point"] == pytest.approx([0.02, 0.0, 0.12])
    assert seen["ball"]["distance"] == pytest.approx(0.015)
    assert seen["vessel"]["axis"] == pytest.approx([0.0, 0.06, 0.0])
    assert seen["vessel"]["distance"] == pytest.approx(0.006), "of the shaft, not of the tip"
    assert seen["floor"]["axis"] == pytest.approx([0.0, 0.0, -1.0])
    assert seen["floor"]["distance"] == pytest.approx(0.03)
