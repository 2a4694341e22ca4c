"""Depth of a ray-traced plane, the methods' interface, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.endoscope_files import lens
from helpers.perception.plane_pair import PlanePair
from helpers.sim.board_views import BARREL, PINHOLE
from surg_core import ConfigError
from surg_perception.depth.rectification import StereoRectifier
from surg_perception.depth.stereo_depth import StereoDepth
from surg_perception.depth.stereo_matcher import MatcherError


def errors(pair: PlanePair, found: np.ndarray) -> np.ndarray:
    """|error| of the known depths in the middle of the picture [m]."""
    away = np.abs(found - pair.depth())[20:-20, 60:-20]
    return away[np.isfinite(away)]


@pytest.mark.parametrize(("lens_of_eyes", "distance"), [(PINHOLE, 0.05), (BARREL, 0.08)])
def test_the_depth_of_a_plane_is_metric(lens_of_eyes, distance: float) -> None:
    pair = PlanePair(replace(lens_of_eyes, edge=0.0), distance)
    found = StereoDepth(*pair.lenses()).look(*pair.pictures())
    away = errors(pair, found.depth)
    print(f"median {1e3 * np.median(away):.2f} mm, p90 {1e3 * np.percentile(away, 90):.2f} mm")
    # A quarter of a pixel is this much depth.
    quarter = 0.25 * distance**2 / (pair.eye.f * pair.baseline)
    assert np.median(away) < quarter and np.percentile(away, 90) < 3 * quarter
    assert found.known > 0.6


def test_eight_directions_find_the_plane() -> None:
    pair = PlanePair(distance=0.06)
    found = StereoDepth(*pair.lenses(), method="sgbm_8").look(*pair.pictures())
    assert np.median(errors(pair, found.depth)) < 0.002


def test_rows_agree_after_rectification_only() -> None:
    pair = PlanePair(BARREL, 0.07, toe=0.02)
    left, right = StereoRectifier(*pair.lenses()).rectify(*pair.pictures())

    def apart(first: np.ndarray, second: np.ndarray) -> float:
        """Largest row offset of patches [px]."""
        import cv2

        best = []
        for x, y in ((120, 60), (200, 60), (120, 170), (200, 170)):
            patch = first[y - 12 : y + 13, x - 12 : x + 13, 0]
            area = second[y - 20 : y + 21, x - 60 : x + 30, 0]
            best.append(cv2.minMaxLoc(cv2.matchTemplate(area, patch, cv2.TM_CCOEFF_NORMED))[3][1])
        return float(np.abs(np.array(best) - 8).max())

    assert apart(left, right) == 0.0
    raw = PlanePair(BARREL, 0.07, toe=0.02).pictures()
    assert apart(*raw) > 0.0


def test_a_smaller_rectified_picture_gives_the_same_depth() -> None:
    pair = PlanePair(distance=0.06)
    small = StereoDepth(*pair.lenses(), size=(160, 120)).look(*pair.pictures())
    assert small.depth.shape == (120, 160)
    # Pixel (i, j) of the small picture lies between pixels 2 i and 2 i + 1 of the large one.
    true = pair.depth()
    true = (true[::2, ::2] + true[1::2, 1::2]) / 2
    away = np.abs(small.depth - true)[10:-10, 30:-10]
    assert np.nanmedian(away) < 0.003


def test_points_project_onto_their_pixels() -> None:
    pair = PlanePair()
    depth = StereoDepth(*pair.lenses())
    g, (u, v) = depth.geometry, (44, 28)
    points = g.points(pair.depth().astype(np.float32), step=4)
    assert points.shape == (60, 80, 3)
    x, y, z = points[v // 4, u // 4].astype(float)
    assert (g.f * x / z + g.cx, g.fy * y / z + g.cy) == pytest.approx((u, v), abs=1e-3)
    right = g.f * (x - g.baseline) / z + g.cx - g.shift
    assert g.depth(u - right) == pytest.approx(z, rel=1e-5)


def test_what_is_not_lit_and_what_is_out_of_range_is_unknown() -> None:
    pair = PlanePair()
    left, right = pair.pictures()
    left[:, :150], right[:, :150] = 3, 3
    found = StereoDepth(*pair.lenses()).look(left, right)
    assert not np.isfinite(found.depth[:, :140]).any()
    assert np.isfinite(found.depth[60:180, 200:300]).mean() > 0.8
    beyond = StereoDepth(*pair.lenses(), near=0.02, far=0.05).look(*pair.pictures())
    assert np.nan_to_num(beyond.depth).max() <= 0.05


def test_a_method_is_added_from_outside(tmp_path: Path) -> None:
    file = tmp_path / "flat.py"
    file.write_text(
        "import numpy as np\n"
        "from surg_perception.depth.stereo_matcher import StereoMatcher\n"
        "class Flat(StereoMatcher):\n"
        "    def disparity(self, left, right):\n"
        "        return np.full(left.shape[:2], 23.0, np.float32)\n"
    )
    pair = PlanePair()
    found = StereoDepth(*pair.lenses(), method=str(file)).look(*pair.pictures())
    np.testing.assert_allclose(found.depth, pair.eye.f * pair.baseline / 20.0, rtol=1e-5)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"method": "census"}, "census: there is no such stereo method; there are sgbm"),
        ({"near": 0.0}, "allowed: 0.005 <= near < far <= 10"),
        ({"near": 0.2, "far": 0.1}, "allowed: 0.005 <= near < far <= 10"),
        ({"far": float("nan")}, "allowed: 0.005 <= near < far <= 10"),
    ],
)
def test_a_method_or_a_range_that_is_none_is_refused(change: dict, said: str) -> None:
    with pytest.raises(MatcherError) as refused:
        StereoDepth(lens("left"), lens("right"), **change)
    assert said in str(refused.value)


def test_lenses_that_make_no_pair_are_refused() -> None:
    left, right = lens("left"), lens("right")
    with pytest.raises(ConfigError, match="swapped"):
        StereoDepth(right, left)
    with pytest.raises(ConfigError, match="image_width"):
        StereoDepth(left, lens("right", 1280, 960))
    P = right.P.copy()
    P[:2, :3] *= 1.02
    with pytest.raises(ConfigError, match="were not measured together"):
        StereoDepth(left, replace(right, P=P))


def test_pictures_of_another_size_are_refused() -> None:
    depth = StereoDepth(lens("left"), lens("right"))
    good = np.zeros((480, 640, 3), np.uint8)
    with pytest.raises(ValueError, match="the right picture has 320 x 240, its lens is for 640"):
        depth.look(good, good[::2, ::2])


def test_a_fisheye_is_rectified_too() -> None:
    eyes = [
        replace(lens(side), distortion_model="equidistant", D=np.array([0.1, -0.05, 0.01, 0.0]))
        for side in ("left", "right")
    ]
    rectifier = StereoRectifier(*eyes)
    y, x = np.mgrid[:480, :640]
    raw = np.stack([x // 4, y // 4, 0 * x], -1).astype(np.uint8)
    seen, _ = rectifier.rectify(raw, raw)
    # The formula of Kannala and Brandt: where the ray of a rectified pixel lies in the raw picture.
    K, P, D = eyes[0].K, eyes[0].P, eyes[0].D
    for u, v in ((320, 240), (100, 100), (560, 400)):
        a, b = (u - P[0, 2]) / P[0, 0], (v - P[1, 2]) / P[1, 1]
        r = np.hypot(a, b)
        t = np.arctan(r)
        bent = t * (1 + D @ [t**2, t**4, t**6, t**8])
        raw_xy = K[:2, 2] + np.array([a, b]) / r * bent * K[[0, 1], [0, 1]]
        assert np.abs(seen[v, u, :2] - raw_xy / 4.0).max() <= 1.0
