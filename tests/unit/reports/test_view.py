"""The page of an episode: complete in itself, and exact under the cursor."""

from __future__ import annotations

import base64
import bisect
import html.parser
import io
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from helpers.recording import recording_synthetic as synthetic
from surg_recording.episode import episode_reader as episodes
from surg_recording.recording_errors import EpisodeError
from surg_recording.reports import episode_events, episode_view, episode_view_data
from surg_recording.video import video_embed

CHROMIUM = shutil.which("chromium")
SECONDS, FRAMES = 1.6, 30


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run with a video: 900 ticks, 30 frames."""
    what = synthetic.Synthetic(seconds=SECONDS, frames=FRAMES)
    return synthetic.record(tmp_path_factory.mktemp("view") / "episode", what)


@pytest.fixture
def folder(recorded: Path, tmp_path: Path) -> Path:
    """A copy to break."""
    return Path(shutil.copytree(recorded, tmp_path / "episode"))


class Page(html.parser.HTMLParser):
    """Elements by id, what is opened and never closed, and every address."""

    VOID = ("meta", "link", "img", "br", "input")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.found: dict[str, str] = {}
        self.addresses: list[str] = []
        self._id = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self._id = values.get("id") or ""
        self.addresses += [str(values[key]) for key in ("src", "href") if key in values]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag
        self._id = ""

    def handle_data(self, data: str) -> None:
        if self._id:
            self.found[self._id] = self.found.get(self._id, "") + data


def data_of(folder: Path, **options: Any) -> tuple[Page, dict[str, Any]]:
    page = Page(episode_view.page(episodes.read(folder), **options))
    return page, json.loads(page.found["data"])


def test_the_page_is_one_file_that_parses_and_needs_nothing(folder: Path) -> None:
    page, data = data_of(folder)
    assert page.open == []
    assert page.addresses == []
    text = episode_view.page(episodes.read(folder))
    assert not re.search(r"https?://|@import|url\(|@[A-Z]+@", text)
    assert data["duration"] == 899 * synthetic.TICK_NS
    assert [curve["title"] for curve in data["arms"][0]["curves"]] == [
        "Depth",
        "RCM deviation",
        "Force on the trocar",
    ]


def test_the_sample_at_the_cursor_is_the_last_that_is_not_later(full: bool) -> None:
    """At stamps, one nanosecond beside them and at random, against bisection."""
    rng = np.random.default_rng(1)
    checks = 0
    for _ in range(2000 if full else 100):
        stamps = np.cumsum(rng.integers(1, 5_000_000, rng.integers(1, 60))) - 1
        for t in [*stamps[:5], *(stamps[:5] - 1), *rng.integers(-10, int(stamps[-1]) + 10, 5)]:
            assert episode_events.at_or_before(stamps, int(t)) == bisect.bisect_right(stamps, t) - 1
            checks += 1
    print(f"{checks} cursors")


def test_values_on_the_page_are_those_of_the_recording(folder: Path) -> None:
    """Every sample of a short episode, to the page's last digit."""
    _, data = data_of(folder)
    cycle = episodes.read(folder).cycle("PSM1")
    arm = data["arms"][0]
    assert arm["rows"] is None
    assert arm["clocks"]["cycle"] == (cycle["stamp_ns"] - cycle["stamp_ns"][0]).tolist()
    depth = arm["curves"][0]["series"][0]["values"]
    assert np.abs(np.array(depth) - cycle["depth"] * 1e3).max() <= 0.0005001
    # The made-up path is stated in the rcm frame: an oracle that knows no quaternion.
    expected = [
        synthetic.Synthetic(seconds=SECONDS).executed(tick * 0.002) * 1e3 for tick in cycle["tick"]
    ]
    assert np.abs(np.array(arm["path"]).T - expected).max() < 0.001
    rcm = {s["name"]: s["values"] for s in arm["curves"][1]["series"]}
    assert np.abs(np.array(rcm["kinematic"]) - 0.02).max() < 1e-4
    assert np.abs(np.array(rcm["true"]) - 0.2).max() < 1e-4
    assert set(arm["curves"][2]["series"][0]["values"]) == {0.5}


def test_every_frame_on_the_page_is_the_recorded_one(folder: Path) -> None:
    """Its number can be read from its brightness; stamp and presentation time belong to it."""
    page, data = data_of(folder)
    video = data["videos"][0]
    assert len(video["stamps"]) == FRAMES
    with av.open(io.BytesIO(base64.b64decode(page.found["video0"]))) as container:
        codec = container.streams.video[0].codec_context.name
        frames = list(container.decode(video=0))
    assert [round(f.pts * f.time_base * 1_000_000) for f in frames] == video["pts"]
    assert codec == "h264"
    for k, frame in enumerate(frames):
        grey = float(frame.to_ndarray(format="rgb24").mean())
        assert abs(grey - ((k + 1) * 7) % 256) < 5
        tick = (k + 1) * 25
        assert video["stamps"][k] == (tick - 1) * synthetic.TICK_NS
        # At the frame's own stamp the cursor shows this frame, just before it the one before.
        assert episode_events.at_or_before(video["stamps"], video["stamps"][k]) == k
        assert episode_events.at_or_before(video["stamps"], video["stamps"][k] - 1) == k - 1


def test_a_large_episode_is_thinned_out_and_keeps_its_extremes(folder: Path) -> None:
    _, data = data_of(folder, max_rows=100)
    arm, cycle = data["arms"][0], episodes.read(folder).cycle("PSM1")
    rows = np.array(arm["rows"])
    assert len(rows) <= 110 < len(cycle) == arm["total"]
    assert {0, len(cycle) - 1, int(np.argmin(cycle["depth"])), int(np.argmax(cycle["depth"]))} <= {
        *rows.tolist()
    }
    assert arm["clocks"]["cycle"] == (cycle["stamp_ns"][rows] - cycle["stamp_ns"][0]).tolist()
    assert arm["tick"] == cycle["tick"][rows].tolist()


def test_no_spike_is_lost_by_thinning_out(full: bool) -> None:
    rng = np.random.default_rng(2)
    for _ in range(300 if full else 30):
        curves = [rng.normal(size=5000), np.full(5000, np.nan), rng.normal(size=5000)]
        curves[0][rng.integers(5000)] = 100.0
        curves[2][rng.integers(5000, size=50)] = np.nan
        rows = episode_view_data.kept_rows(curves, 300)
        assert len(rows) <= 310
        assert (np.diff(rows) > 0).all()
        assert curves[0][rows].max() == 100.0
        assert np.nanmin(curves[2][rows]) == np.nanmin(curves[2])


def test_a_video_above_the_budget_is_thinned_out(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = folder / "endoscope_left.mp4"
    monkeypatch.setattr(video_embed, "SMALL_FRAME", path.stat().st_size // 10)
    shown = video_embed.embed(path, 50_000)
    assert shown.note == ""
    small = video_embed.embed(path, path.stat().st_size - 1)
    nth = small.frames[1] - small.frames[0]
    assert nth in (3, 4)
    assert f"one frame of {nth}" in small.note
    with av.open(io.BytesIO(small.data)) as container:
        greys = [float(f.to_ndarray(format="gray").mean()) for f in container.decode(video=0)]
    expected = [((k + 1) * 7) % 256 for k in small.frames]
    assert np.abs(np.array(greys) - expected).max() < 8
    assert small.pts.tolist() == (small.frames * 50_000).tolist()


@pytest.mark.parametrize(
    ("breakage", "words"),
    [
        ("no truth", "no force and no true RCM deviation"),
        ("no video", "no video: it was recorded without a camera"),
        ("broken video", "no readable video"),
        ("no events", "no events were recorded"),
        ("broken cycles", "cycle_PSM1.csv, line 902: 1 fields"),
        ("no cycles", "cycle_PSM1: nothing was recorded"),
    ],
)
def test_what_is_missing_is_said_and_the_rest_is_shown(
    folder: Path, breakage: str, words: str
) -> None:
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    if breakage == "no truth":
        del manifest["tables"]["ground_truth_PSM1"]
    elif breakage == "no video":
        manifest["videos"] = {}
    elif breakage == "broken video":
        (folder / "endoscope_left.mp4").write_bytes(b"nothing")
    elif breakage == "no events":
        del manifest["tables"]["events"]
    elif breakage == "broken cycles":
        with open(folder / "cycle_PSM1.csv", "a") as file:
            file.write("1\n")
    else:
        del manifest["tables"]["cycle_PSM1"]
    path.write_text(json.dumps(manifest))
    page, data = data_of(folder)
    assert page.open == []
    assert words in episode_view.page(episodes.read(folder))
    assert bool(data["videos"]) == ("video" not in breakage)
    assert bool(data["arms"]) == ("cycles" not in breakage)


def test_nothing_to_show_is_said(folder: Path) -> None:
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "tables": {}, "videos": {}}))
    with pytest.raises(EpisodeError, match="nothing to show"):
        episode_view.page(episodes.read(folder))


def test_text_of_the_recording_is_never_code(folder: Path) -> None:
    evil = "</script><script>alert(1)</script>"
    with open(folder / "events.csv", "a") as file:
        file.write(f"1000000000,1,/PSM1/warning,/x,{evil}\n")
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "run": {"title": evil}}))
    page, data = data_of(folder)
    assert page.open == []
    assert any(evil in event["text"] for event in data["events"])
    assert "<script>alert" not in episode_view.page(episodes.read(folder))


def test_an_event_without_a_stamp_stands_where_it_was_received(folder: Path) -> None:
    """The made-up recorder receives tick k at k ns."""
    with open(folder / "events.csv", "a") as file:
        file.write("0,500,/PSM1/warning,/x,no stamp\n600000000,7,/PSM1/error,/x,stamped\n")
    _, data = data_of(folder)
    events = {event["text"]: event for event in data["events"]}
    assert events["PSM1: no stamp"]["t"] == 499 * synthetic.TICK_NS
    assert events["PSM1: no stamp"]["exact"] is False
    assert events["PSM1: stamped"] == {
        "t": 600_000_000 - synthetic.TICK_NS,
        "kind": "error",
        "text": "PSM1: stamped",
        "exact": True,
    }


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed (apt install chromium)")
@pytest.mark.parametrize("t", [0.0479, 0.7391])
def test_the_browser_points_at_the_same_sample(folder: Path, tmp_path: Path, t: float) -> None:
    """view.js in a real browser against the same question asked of the recording."""
    out = episode_view.write(episodes.read(folder), tmp_path / "view.html")
    assert CHROMIUM is not None
    profile = f"--user-data-dir={tmp_path / 'profile'}"
    argv = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", profile, "--dump-dom"]
    done = subprocess.run(
        [*argv, f"{out.as_uri()}#t={t}"], capture_output=True, text=True, timeout=120, check=True
    )
    said = re.sub(r"<[^>]+>", " ", done.stdout[: done.stdout.index('id="video0"')])
    recorded = episodes.read(folder)
    stamps = recorded.cycle("PSM1")["stamp_ns"]
    now = int(stamps[0]) + round(t * 1e9)
    tick = recorded.cycle("PSM1")["tick"][episode_events.at_or_before(stamps, now)]
    assert re.search(rf"tick\s+{tick}\s", said)
    frame = episode_events.at_or_before(recorded.video("endoscope_left").frames["stamp_ns"], now)
    expected = f"frame {frame}, stamp" if frame >= 0 else "no picture yet"
    assert expected in said
