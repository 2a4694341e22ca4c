"""The simulated lens bends pictures as its formula states, and is off by default."""

from __future__ import annotations

import numpy as np
import pytest

from surg_sim.appearance.lens import EndoscopeLens, LensRemap, TrueEye
from surg_sim.physics.patient_settings import SETTINGS, find_setting

BARREL = find_setting("phantom+lens").lens


@pytest.mark.parametrize("name", SETTINGS)
def test_no_setting_has_a_lens_unless_it_is_asked_for(name: str) -> None:
    assert find_setting(name).lens.perfect
    assert not find_setting(f"{name}+lens").lens.perfect


def test_rays_are_the_inverse_of_the_bend() -> None:
    pixels = np.random.default_rng(1).uniform([0, 0], [639, 479], (200, 2))
    rays = BARREL.rays(pixels, 451.4, 640, 480)
    K = BARREL.camera_matrix(451.4, 640, 480)
    np.testing.assert_allclose(BARREL.bend(rays) * K[0, 0] + K[:2, 2], pixels, atol=1e-5)


def test_each_pixel_shows_what_lies_on_its_ray() -> None:
    lens = EndoscopeLens(BARREL.distortion, BARREL.zoom, BARREL.centre)
    remap = LensRemap(TrueEye(lens, 200.0, 320, 240))
    width, height = remap.wide_size
    assert width >= 320 and height >= 240
    # The pinhole's picture states its own columns and rows.
    y, x = np.mgrid[:height, :width]
    wide = np.stack([x // 2, y // 2, np.zeros_like(x)], axis=-1).astype(np.uint8)
    seen = remap.apply(wide)
    assert seen.shape == (240, 320, 3)
    for u, v in ((0, 0), (319, 239), (160, 120), (40, 200)):
        ray = lens.rays(np.array([u, v], dtype=float), 200.0, 320, 240)
        expected = (200.0 * ray + [(width - 1) / 2, (height - 1) / 2]) / 2.0
        assert np.abs(seen[v, u, :2] - expected).max() <= 1.0


def test_the_edge_of_the_picture_is_darker() -> None:
    light = BARREL.light(64, 48)
    assert light.max() > 0.999 and light[0, 0] == pytest.approx(1.0 - BARREL.edge)
