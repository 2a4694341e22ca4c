"""Summaries of made-up runs, whose numbers are known by construction, and the report about them."""

from __future__ import annotations

import html.parser
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.recording import recording_synthetic as synthetic
from helpers.recording.recording_synthetic import Synthetic
from helpers.recording.restated import edit_field, restate
from surg_recording.episode import episode_reader
from surg_recording.recording_errors import EpisodeError, NoMotionError
from surg_recording.reports import (
    episode_view,
    run_figures,
    run_report,
    run_series,
    run_summary,
)

KEYS = {
    *("robot", "motion", "mode", "law", "link", "duration_s", "scale", "rcm_kinematic_mm"),
    *("rcm_true_mm", "tip_error_mm", "tip_lag_ms", "path_length_mm", "shaft_sweep_deg"),
    *("enabled_fraction", "unscaled_fraction", "smoothness", "controller", "trocar"),
    *("deterministic", "state_hash", "versions", "commands_refused"),
}


def summarise(tmp_path: Path, what: Synthetic, **run: Any) -> dict[str, Any]:
    folder = synthetic.record(tmp_path / "episode", what, **run)
    return run_summary.summarise(episode_reader.read(folder))


@pytest.mark.parametrize("spherical", [False, True])
def test_a_good_run_has_exactly_the_numbers_it_was_made_with(
    tmp_path: Path, spherical: bool
) -> None:
    got = summarise(tmp_path, Synthetic(spherical=spherical))
    assert got["ok"] and got["reasons"] == []
    assert set(got) >= KEYS
    for key, value in (("rcm_kinematic_mm", 0.02), ("rcm_true_mm", 0.2)):
        assert set(got[key]) == {"mean", "median", "p95", "max"}
        for statistic in got[key].values():
            assert statistic == pytest.approx(value, abs=1e-9)
    assert got["tip_lag_ms"] == pytest.approx(12.4, abs=0.01)
    assert got["tip_error_mm"]["rms"] < 1e-3
    assert got["tip_error_mm"]["max"] < 2e-3
    assert got["duration_s"] == pytest.approx(5.998)
    assert got["enabled_fraction"] == got["unscaled_fraction"] == 1.0
    assert got["trocar"]["force_n"]["mean"] == pytest.approx(0.5)
    assert got["trocar"]["displacement_mm"]["max"] == pytest.approx(0.12)
    controller = got["controller"]
    assert controller["rate_hz"] == pytest.approx(500.0)
    assert controller["compute_us"] == {"p50": 8.0, "p99": 8.0}
    assert controller["period_us"] is None
    assert controller["overruns"] == 0
    assert got["deterministic"] is True
    assert got["state_hash"] == "ab" * 32
    assert got["input_source"] == ("servo_jp" if spherical else "servo_cp")
    t = np.arange(0.102, 6.1, 0.002)
    length = np.sum(np.linalg.norm(np.diff([synthetic.path(x) for x in t], axis=0), axis=1)) * 1e3
    assert got["path_length_mm"]["input"] == pytest.approx(length, rel=2e-3)
    assert got["path_length_mm"]["executed"] == pytest.approx(length, rel=5e-3)
    assert got["smoothness"]["preset"] == "reference"
    assert got["smoothness"]["presets"]["paper"]["parameters"]["sparc_padlevel"] == 0
    json.dumps(got)


def test_the_sweep_is_the_largest_angle_of_the_fan(tmp_path: Path) -> None:
    got = summarise(tmp_path, Synthetic(kinematic_offset=0.0, true_offset=0.0))
    what = Synthetic()
    tips = np.array([what.executed(k * 0.002) for k in range(51, 3051, 10)])
    s = tips / np.linalg.norm(tips, axis=1, keepdims=True)
    assert got["shaft_sweep_deg"] == pytest.approx(np.degrees(np.arccos((s @ s.T).min())), abs=0.05)


def test_the_tip_error_uses_the_truth_and_states_the_measured_one_beside(tmp_path: Path) -> None:
    # 3 mm off along x, which the motion itself cannot explain by a lag
    got = summarise(tmp_path, Synthetic(tip_offset=3e-3))
    assert got["tip_error_mm"]["rms"] == pytest.approx(3.0, abs=0.35)
    assert got["tip_error_measured_mm"]["rms"] < 1e-3
    assert not got["ok"]
    assert any("tip error, rms" in reason for reason in got["reasons"])


def test_without_a_simulator_the_measured_tip_counts(tmp_path: Path) -> None:
    got = summarise(tmp_path, Synthetic(seconds=2.0, truth=False))
    assert got["rcm_true_mm"] is None and got["trocar"] is None
    assert got["rcm_kinematic_mm"]["max"] == pytest.approx(0.02)
    assert got["tip_error_mm"] == got["tip_error_measured_mm"]
    assert got["ok"]


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        (Synthetic(seconds=1.0, kinematic_offset=0.031e-3), "kinematic RCM deviation, mean"),
        (Synthetic(seconds=1.0, kinematic_offset=0.31e-3), "kinematic RCM deviation, max"),
        (Synthetic(seconds=1.0, true_offset=0.51e-3), "true RCM deviation, max"),
        (Synthetic(seconds=1.0, disabled_ticks=1), r"cycles enabled \[%\]: 99.8, allowed ≥ 100"),
        (Synthetic(seconds=1.0, scaled_ticks=11), "cycles unscaled"),
        (Synthetic(seconds=2.0, fault_at=1.0), r"FAULT after 0\.998 s: rcm_error, 2\.1 mm"),
        (
            Synthetic(seconds=3.5, hold=(1.0, 3.5)),
            r"the arm was held for 2\.\d\d s from 0\.9\d s on",
        ),
        (Synthetic(seconds=1.0, constant=True), r"the tip did not move: executed path 0\.000 mm"),
    ],
)
def test_a_broken_limit_is_a_reason(tmp_path: Path, what: Synthetic, reason: str) -> None:
    got = summarise(tmp_path, what)
    assert not got["ok"]
    assert any(re.search(reason, text) for text in got["reasons"]), got["reasons"]


@pytest.mark.parametrize(
    "what",
    [
        Synthetic(seconds=1.0, kinematic_offset=0.0299e-3),
        Synthetic(seconds=1.0, true_offset=0.499e-3),
        Synthetic(seconds=1.0, scaled_ticks=10),
        Synthetic(seconds=3.5, hold=(1.0, 2.9)),
    ],
)
def test_just_inside_a_limit_is_no_reason(tmp_path: Path, what: Synthetic) -> None:
    got = summarise(tmp_path, what)
    about_tracking = ("tip error", "executed path")
    left = [r for r in got["reasons"] if not r.startswith(about_tracking)]
    assert left == []


def test_a_run_that_stopped_half_way_fails_by_that_name(tmp_path: Path) -> None:
    got = summarise(tmp_path, Synthetic(seconds=4.0, refused_from=1.0))
    assert not got["ok"]
    assert got["commands_refused"] == pytest.approx(1600, abs=60)
    (reason,) = [text for text in got["reasons"] if "of the motion was executed" in text]
    assert re.match(r"2\d % of the motion", reason)
    assert f"refused {got['commands_refused']} of " in reason
    assert re.search(r"first after 0\.[89]\d\d s \(stale\)", reason)


def test_the_sweep_is_judged_only_for_a_full_motion(tmp_path: Path) -> None:
    short = summarise(tmp_path / "short", Synthetic(seconds=0.4))
    assert short["shaft_sweep_deg"] < 20
    assert not any("sweep" in reason for reason in short["reasons"])
    whole = summarise(tmp_path / "whole", Synthetic(seconds=0.4), full_motion=True)
    assert any("sweep" in reason for reason in whole["reasons"])


def test_free_run_states_the_period(tmp_path: Path) -> None:
    got = summarise(tmp_path, Synthetic(mode="freerun", seconds=2.0))
    assert got["controller"]["period_us"]["p50"] == pytest.approx(2003, abs=1)
    assert got["time"] == "freerun"


def test_velocity_commands_are_compared_with_the_goal(tmp_path: Path) -> None:
    folder = synthetic.record(tmp_path / "episode", Synthetic(seconds=2.0))
    lines = (folder / "command_PSM1.csv").read_text().splitlines()
    (folder / "command_PSM1.csv").write_text(lines[0] + "\n")
    restate(folder)
    got = run_summary.summarise(episode_reader.read(folder))
    assert got["input_source"] == "cycle.p_goal"
    assert got["tip_lag_ms"] == pytest.approx(12.4, abs=0.01)


def test_a_30_hz_stream_and_a_late_start_are_interpolated(tmp_path: Path) -> None:
    folder = synthetic.record(tmp_path / "episode", Synthetic())
    path = folder / "command_PSM1.csv"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join([lines[0], *lines[1::16]]))
    restate(folder)
    got = run_summary.summarise(episode_reader.read(folder))
    assert got["tip_lag_ms"] == pytest.approx(12.4, abs=0.3)
    assert got["tip_error_mm"]["rms"] < 0.05


def test_missing_ticks_in_lockstep_are_a_reason(tmp_path: Path) -> None:
    what = Synthetic(seconds=1.0)
    folder = synthetic.record(tmp_path / "episode", what)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["tables"]["cycle_PSM1"]["missing_ticks"] = 3
    manifest["sim"]["aborted"] = "no answer from PSM1 for 10 s"
    (folder / "manifest.json").write_text(json.dumps(manifest))
    got = run_summary.summarise(episode_reader.read(folder))
    assert "cycle_PSM1: 3 ticks are missing" in got["reasons"]
    assert "the simulation was aborted: no answer from PSM1 for 10 s" in got["reasons"]


def test_nan_anywhere_fails(tmp_path: Path) -> None:
    folder = synthetic.record(tmp_path / "episode", Synthetic(seconds=1.0))
    edit_field(folder / "ground_truth_PSM1.csv", 200, "shaft_x", "nan")
    restate(folder)
    got = run_summary.summarise(episode_reader.read(folder))
    assert not got["ok"]
    assert any("true RCM deviation, max [mm]: not measured" in r for r in got["reasons"])


def test_no_motion_at_all(tmp_path: Path) -> None:
    folder = synthetic.record(tmp_path / "episode", Synthetic(seconds=0.0))
    recorded = episode_reader.read(folder)
    with pytest.raises(NoMotionError):
        run_series.load(recorded)
    got = run_report.make(tmp_path)
    assert not got["ok"]
    assert "no motion" in got["reasons"][0]
    assert set(got) >= KEYS
    assert got["rcm_kinematic_mm"] is None
    assert "no motion" in (tmp_path / "report.html").read_text()


def test_the_wrong_arm_is_named(tmp_path: Path) -> None:
    recorded = episode_reader.read(synthetic.record(tmp_path / "episode", Synthetic(seconds=0.2)))
    with pytest.raises(EpisodeError, match="no arm 'PSM3'; there are PSM1"):
        run_series.load(recorded, "PSM3")


class _Page(html.parser.HTMLParser):
    """Counts images and finds references that leave the file or tags left open."""

    def __init__(self) -> None:
        super().__init__()
        self.images = 0
        self.outside: list[str] = []
        self.open: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        for name, value in attributes:
            if name in ("src", "href") and not (value or "").startswith("data:"):
                self.outside.append(str(value))
        self.images += tag == "img"
        if tag not in ("img", "meta"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag, tag

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_report_is_one_file_with_every_figure(tmp_path: Path) -> None:
    what = Synthetic(seconds=3.0, frames=40)
    synthetic.record(tmp_path / "episode", what, motion="<b>my & motion</b>", operator="anna")
    run_report.make(tmp_path)
    stored = json.loads((tmp_path / "summary.json").read_text())
    assert stored["ok"] and set(stored) >= KEYS
    pictures = {p.stem for p in (tmp_path / "figures").glob("*.png")}
    assert pictures == set(run_figures.FIGURES)
    page = _Page()
    page.feed((tmp_path / "report.html").read_text())
    assert page.open == [] and page.outside == []
    assert page.images == len(pictures) + run_report.STRIP_FRAMES
    for text in ("met every limit", "<b>my & motion</b>", "anna", "Definitions"):
        assert text in page.text


@pytest.mark.parametrize(
    ("motion", "title"),
    [
        ("/home/anna/surg/src/surg_teleop/motions/bundled.csv", "The bundled hand motion"),
        ("/home/anna/knots/second try.csv", "second try"),
    ],
)
def test_a_title_is_a_name_and_not_a_path(tmp_path: Path, motion: str, title: str) -> None:
    """The path stands where the report says what was run."""
    synthetic.record(tmp_path / "episode", Synthetic(seconds=0.5), motion=motion, robot="ur5e")
    run_report.make(tmp_path)
    text = (tmp_path / "report.html").read_text()
    assert f"<h1>{title}: UR5e</h1>" in text and motion in text
    view = episode_view.page(episode_reader.read(tmp_path / "episode"))
    assert f"{title} · UR5e" in view


def test_a_failed_run_says_why(tmp_path: Path) -> None:
    synthetic.record(tmp_path / "episode", Synthetic(seconds=1.0, true_offset=2e-3))
    reasons = run_report.make(tmp_path)["reasons"]
    assert "true RCM deviation, max [mm]: 2, allowed ≤ 0.5" in reasons
    assert "did not meet its limits" in (tmp_path / "report.html").read_text()


def test_states_that_a_starved_link_showed_more_than_once_are_drawn(tmp_path: Path) -> None:
    """Most steps in time are 0 then; the figures are of the others."""
    what = Synthetic(seconds=3.0, mode="freerun", repeats=3)
    synthetic.record(tmp_path / "episode", what)
    run_report.make(tmp_path)
    assert (tmp_path / "figures" / "speed.png").is_file()


def test_no_episode_is_named(tmp_path: Path) -> None:
    with pytest.raises(EpisodeError, match="no such folder"):
        run_report.make(tmp_path)


def test_a_lost_video_is_said_and_the_rest_goes_on(tmp_path: Path) -> None:
    folder = synthetic.record(tmp_path / "episode", Synthetic(seconds=1.0, frames=10))
    (folder / "endoscope_left.mp4").unlink()
    run_report.make(tmp_path)
    assert "the file is missing" in (tmp_path / "report.html").read_text()


def test_an_envelope_keeps_the_extremes_of_all_samples() -> None:
    rng = np.random.default_rng(3)
    t, values = np.sort(rng.uniform(0, 10, 5000)), rng.normal(size=5000)
    middle, low, high, centre = run_figures.envelope(t, values)
    assert len(middle) == run_figures.BANDS and (np.diff(middle) > 0).all()
    assert low.min() == values.min() and high.max() == values.max()
    assert (low <= centre).all() and (centre <= high).all()
    few = run_figures.envelope(t[:3], values[:3])
    assert sorted(few[3]) == sorted(values[:3])
