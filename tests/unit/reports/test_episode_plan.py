"""A policy's plan on an episode's page: at its pixel, at its time, and nothing where it lacks."""

from __future__ import annotations

import asyncio
import base64
import json
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import surg_core
from conftest import FULL
from helpers.endoscope_files import lens
from helpers.recording import recording_synthetic as synthetic
from helpers.teleop import chromium
from helpers.teleop.chromium import Chromium
from surg_cli.host import paths
from surg_core.held_endoscope import held_endoscope
from surg_core.transforms import matrix_to_quaternion_xyzw
from surg_msgs.msg import PolicyPlan
from surg_recording.calibration.endoscope_record import describe_endoscope
from surg_recording.episode import episode_reader as episodes
from surg_recording.episode.message_fields import Flat
from surg_recording.episode.table import Table
from surg_recording.reports import episode_plan, episode_view

CELL = paths.CELLS / "sim_two_arms"
LENS = lens("left")
NAMES = [f"PSM1/{name}" for name in ("x", "y", "z", "roll", "jaw")]
SEEN = np.array([[-0.01, 0.0, 0.08], [0.0, 0.005, 0.09], [0.012, -0.004, 0.1]])
"""[m] Planned tips before the left eye."""


class Recorded:
    """As much of an episode as plans need."""

    def __init__(self, messages: list[tuple[int, PolicyPlan]], **manifest: Any) -> None:
        cell = surg_core.load_cell(CELL)
        held = held_endoscope(cell)
        assert held is not None
        self.folder, self.arms = Path("episode"), ["PSM1", "ECM"]
        self.topics = {episode_plan.TOPIC: ["topics/policy_plan"]}
        model = {k: np.ravel(getattr(LENS, k)).tolist() for k in ("D", "K", "R", "P")}
        model |= {"width": 640, "height": 480, "distortion_model": "plumb_bob"}
        described, problems = describe_endoscope(CELL / "cell.yaml")
        assert not problems
        self.manifest = {"camera_info": {"endoscope_left": model}, "cell": {"endoscope": described}}
        self.manifest["tables"] = {"topics/policy_plan": {"columns": ["session", "seq"]}}
        self.manifest |= manifest
        self.q = np.array(cell.arms["ECM"].robot.home) + 0.01
        self.X_WV = held.X_WB @ np.asarray(held.chain.forward(self.q)) @ np.asarray(held.X_FV)
        self.X_WB = np.asarray(cell.arms["PSM1"].X_WB)
        rng = np.random.default_rng(4)
        self.X_BR = np.eye(4)
        self.X_BR[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        self.X_BR[:3, :3] *= np.linalg.det(self.X_BR[:3, :3])
        self.X_BR[:3, 3] = [0.4, 0.1, 0.3]
        self._messages = messages

    def _plans(self) -> Table:
        flats = [(stamp, Flat(message)) for stamp, message in self._messages]
        names = list(dict.fromkeys(name for _, flat in flats for name in flat.values))
        columns = {"stamp_ns": np.array([stamp for stamp, _ in flats])}
        for name in names:
            columns[name] = np.array([flat.values.get(name) for _, flat in flats], dtype=object)
        return Table("policy_plan", columns)

    def tips(self, p_V: np.ndarray) -> np.ndarray:
        """Tips (n, 3) in the rcm frame of points before the left eye."""
        X_RV = np.linalg.inv(self.X_WB @ self.X_BR) @ self.X_WV
        return p_V @ X_RV[:3, :3].T + X_RV[:3, 3]

    def columns(self, name: str, wanted: Any) -> Table:
        if name == "topics/policy_plan":
            assert "session" not in wanted, "it may need all 64 bits, which no reader has"
            return self._plans()
        stamps = np.array([0, 10**9, 2 * 10**9])
        if name == "cycle_ECM":
            # Only from the second row on does the camera stand where the test believes it.
            rows = np.array([self.q * 0.0, self.q, self.q])
            joints = {f"q{i}": rows[:, i] for i in range(6)}
        else:
            joints = {}
        quaternion = matrix_to_quaternion_xyzw(self.X_BR[:3, :3])
        frame = {f"q_br_{a}": np.full(3, v) for a, v in zip("xyzw", quaternion, strict=True)}
        frame |= {f"p_rcm_{a}": np.full(3, v) for a, v in zip("xyz", self.X_BR[:3, 3], strict=True)}
        return Table(name, {"stamp_ns": stamps, **frame, **joints})


def message(p_R: np.ndarray, **more: Any) -> PolicyPlan:
    rows = np.hstack([p_R, np.zeros((len(p_R), 2))])
    values = {"confidence": math.nan, "area": [0.0, 0.0, 1.0, 1.0], **more}
    return PolicyPlan(names=NAMES, rows=len(rows), values=rows.ravel().tolist(), **values)


def collected(recorded: Recorded) -> tuple[list[dict[str, Any]], list[str]]:
    missing: list[str] = []
    plans = episode_plan.collect(recorded, 5, missing)  # type: ignore[arg-type]
    json.dumps(plans, allow_nan=False)
    return plans, missing


def test_a_recorded_plan_lies_where_opencv_projects_it() -> None:
    recorded = Recorded([])
    recorded._messages = [(10**9 + 5, message(recorded.tips(SEEN)))]
    (plan,), missing = collected(recorded)
    pixels, _ = cv2.projectPoints(SEEN, np.zeros(3), np.zeros(3), LENS.K, LENS.D)
    np.testing.assert_allclose(plan["ways"][0], (pixels[:, 0] + 0.5) / (640, 480), atol=6e-5)
    assert plan["t"] == 10**9 and missing == []


def test_what_was_said_comes_back_and_its_sizes_are_bounded() -> None:
    data = bytes(range(6))
    said = {
        "keypoints": ["tip"], "x": [0.25], "y": [0.5], "certainty": [0.75], "phase": "pulling",
        "map_rows": 2, "map_columns": 3, "attention": data, "rejected": 2, "rule": "step",
        "text": "too far", "confidence": 0.5, "picture": "observation.images.endoscope.left",
    }  # fmt: skip
    recorded = Recorded([])
    long = np.tile(recorded.tips(SEEN), (10, 1))
    recorded._messages = [(2 * 10**9, message(long, **said)), (10**9, message(long[:1]))]
    (first, second), _ = collected(recorded)
    assert (first["phase"], first["confidence"], first["points"]) == ("", None, [])
    assert len(first["ways"][0]) == 1 and len(second["ways"][0]) == episode_plan.STEPS
    assert second["points"] == [["tip", 0.25, 0.5, 0.75]] and second["phase"] == "pulling"
    assert base64.b64decode(second["map"]["data"]) == data and second["confidence"] == 0.5
    assert (second["counts"]["rejected"], second["rule"], second["text"]) == (2, "step", "too far")
    many = [(10**9 + i, message(long[:1], **said)) for i in range(2 * episode_plan.MAX_MAPS)]
    plans, _ = collected(Recorded(many))
    assert sum(plan["map"] is not None for plan in plans) == episode_plan.MAX_MAPS


@pytest.mark.parametrize(
    "manifest", [{"camera_info": {}}, {"cell": {}}, {"cell": {"endoscope": None}}]
)
def test_without_a_camera_the_words_stay_and_the_page_says_why(manifest: dict[str, Any]) -> None:
    recorded = Recorded([(10**9, message(np.ones((2, 3)), phase="pulling"))], **manifest)
    (plan,), missing = collected(recorded)
    assert plan["ways"] == [] and plan["phase"] == "pulling" and len(missing) == 1


@pytest.mark.skipif(not FULL, reason="./surg test --full")
@pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing())
def test_the_page_draws_it_at_its_pixel_and_its_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    what = synthetic.Synthetic(seconds=1.6, frames=30)
    episode = episodes.read(synthetic.record(tmp_path / "episode", what))
    counts = dict.fromkeys(episode_plan.COUNTS, 0) | {"rejected": 3}
    plan = {
        "ways": [[[0.25, 0.5], [0.5, 0.25]]], "points": [["tip", 0.75, 0.75, 1.0]], "map": None,
        "phase": "pulling", "confidence": 0.5, "counts": counts, "rule": "step", "text": "far",
    }  # fmt: skip
    plans = [{"t": 4 * 10**8, **plan}, {"t": 9 * 10**8, **plan, "ways": [], "phase": "lifting"}]
    monkeypatch.setattr(episode_plan, "collect", lambda *_: plans)
    page = tmp_path / "view.html"
    page.write_text(episode_view.page(episode), "utf-8")

    async def test() -> None:
        async with Chromium() as browser:
            tab = await browser.open(page.as_uri())
            await tab.until("document.querySelector('video')?.videoWidth > 0", "a video", 20.0)
            size = await tab.run("[...document.querySelectorAll('video')].map(v => v.videoWidth)")
            shown = "document.querySelector('.picture canvas')"
            box = f"""(() => {{ const c = {shown}, d = c.getContext('2d')
              .getImageData(0, 0, c.width, c.height).data; let b = [1e9, 1e9, -1, -1];
              for (let i = 0; i < d.length / 4; i++) if (d[4 * i + 3] > 40 && d[4 * i] > 200) {{
                const x = i % c.width, y = Math.floor(i / c.width);
                b = [Math.min(b[0], x), Math.min(b[1], y), Math.max(b[2], x + 1),
                  Math.max(b[3], y + 1)]; }}
              return b[2] < 0 ? null : [...b, c.width, c.height] }})()"""
            note = "document.querySelector('#videos .plan').textContent"
            await tab.run("episodeView.go(3e8)")
            assert await tab.run(box) is None and "no plan" in await tab.run(note)
            await tab.run("episodeView.go(5e8)")
            caption = await tab.run("document.querySelector('#videos figcaption').textContent")
            assert caption.startswith("endoscope_left · frame") and "object" not in caption
            found = await tab.run(box)
            width, height, unit = size[0], found[5], found[5] / 480
            expected = [0.25 * width - 2 * unit, 0.25 * height - 4 * unit]
            expected += [0.5 * width + 4 * unit, 0.5 * height + 2 * unit]
            np.testing.assert_allclose(found[:4], expected, atol=1.5)
            words = await tab.run(note)
            assert "pulling · 50 % sure · refused 3" in words and "by step: far" in words
            await tab.run("episodeView.go(9.5e8)")
            assert await tab.run(box) is None and "lifting" in await tab.run(note)
            await tab.run("episodeView.go(5e8)")
            await tab.key("KeyP", True, "p")
            assert await tab.run(box) is None and await tab.run(note) == ""
            assert browser.errors == []

    asyncio.run(asyncio.wait_for(test(), 60.0))
