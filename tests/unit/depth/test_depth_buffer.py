"""Show: depth against the simulator's depth buffer."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.recording.stereo_recording import EYES, camera_info, record_pairs
from helpers.results.depth_results import CRFS, METHODS, PAGE
from helpers.sim.depth_views import DepthScene, DepthView
from surg_perception.depth.stereo_depth import StereoDepth
from surg_recording.video import exact_values


@pytest.fixture(scope="module")
def scene() -> DepthScene:
    return DepthScene()


@pytest.fixture(scope="module")
def views(scene: DepthScene) -> list[DepthView]:
    return list(scene.views())


def judged(depth: StereoDepth, views: list[DepthView]) -> tuple[float, float, str]:
    """Median and 90th percentile [m] of the errors, and a line for the page."""
    away, counted, spent = [], 0, []
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    for view in views:
        begun = time.process_time()
        found = depth.look(view.left, view.right).depth
        spent.append(time.process_time() - begun)
        counts = view.counts
        error = np.abs(found - view.depth)[counts]
        away.append(error[np.isfinite(error)])
        counted += int(counts.sum())
    cv2.setNumThreads(threads)
    errors = np.concatenate(away)
    median, p90 = np.percentile(errors, [50, 90])
    said = (
        f"median {1e3 * median:.2f} mm, p90 {1e3 * p90:.2f} mm, over 3 mm "
        f"{100 * np.mean(errors > 0.003):.0f} %, known {100 * len(errors) / counted:.0f} %, "
        f"{1e3 * np.median(spent):.0f} ms"
    )
    return float(median), float(p90), said


@pytest.mark.full
@pytest.mark.parametrize("method", METHODS)
def test_each_method_at_640_x_480(method: str, scene: DepthScene, views: list[DepthView]) -> None:
    median, p90, said = judged(StereoDepth(*scene.lenses(), method=method), views)
    PAGE.note(f"{method}, 640 x 480", len(views), said)
    if method == "sgbm":
        assert median <= 0.0012 and p90 <= 0.003


@pytest.fixture(scope="module")
def moving(scene: DepthScene) -> list[DepthView]:
    return list(scene.way(24))


@pytest.mark.full
@pytest.mark.parametrize("crf", CRFS)
def test_the_command_on_a_recording(
    crf: int,
    scene: DepthScene,
    moving: list[DepthView],
    surg: Callable[..., int],
    tmp_path: Path,
) -> None:
    models = {eye: camera_info(lens) for eye, lens in zip(EYES, scene.lenses(), strict=True)}
    pairs = [(view.left, view.right) for view in moving]
    episode = record_pairs(tmp_path / "episode", pairs, models, quality=str(crf))
    assert surg("episode", "depth", episode) == 0
    away = []
    for view, values in zip(
        moving, exact_values.read(tmp_path / "episode_depth" / "endoscope_depth.mp4"), strict=True
    ):
        known = view.counts & (values > 0)
        away.append(np.abs(1e-4 * values - view.depth)[known])
    errors = np.concatenate(away)
    median, p90 = np.percentile(errors, [50, 90])
    PAGE.note(
        f"`./surg episode depth`, crf {crf}",
        len(moving),
        f"median {1e3 * median:.2f} mm, p90 {1e3 * p90:.2f} mm, over 3 mm "
        f"{100 * np.mean(errors > 0.003):.0f} %",
    )
    if crf <= 18:
        assert p90 <= 0.0035


@pytest.mark.full
def test_a_larger_picture_is_more_exact() -> None:
    large = DepthScene((1280, 720))
    views = list(large.views())
    large.eyes.close()
    median, p90, said = judged(StereoDepth(*large.lenses()), views)
    PAGE.note("sgbm, 1280 x 720", len(views), said)
    assert median <= 0.0007 and p90 <= 0.002
