"""LeRobot data sets of others: what they state twice must agree; nothing is lost silently."""

from __future__ import annotations

import argparse
import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.foreign.foreign_sources import (
    MAP,
    NAMES,
    Rows,
    shown_number,
    tip,
    write_set,
    write_video,
)
from surg_cli.commands.episode import evaluate as command_evaluate
from surg_cli.commands.episode import make_film
from surg_console.labelling.label_pages import LabelPages
from surg_recording import datasets, episode
from surg_recording.datasets import ExportOptions
from surg_recording.imports.ledger import Ledger
from surg_recording.imports.lerobot_reader import import_episode
from surg_recording.imports.lerobot_set import LeRobotData, rate
from surg_recording.recording_errors import EpisodeError
from surg_recording.video import video_file

SECOND = 1_000_000_000


def numbers_of(folder: Path) -> list[int]:
    """What the pictures show, in the order of their stamps."""
    video = episode.read(folder).video("cam")
    images = video_file.grab(video.path, range(len(video.frames)))
    return [shown_number(image) for image in images]


@pytest.mark.parametrize(
    ("stated", "hz"),
    [
        (29.97, Fraction(2997, 100)),
        pytest.param(30000 / 1001, Fraction(30000, 1001), marks=pytest.mark.full),
        (12.5, Fraction(25, 2)),
        pytest.param(30, Fraction(30), marks=pytest.mark.full),
    ],
)
def test_rates_are_rational(stated: float, hz: Fraction, tmp_path: Path) -> None:
    assert rate(stated) == hz
    root = write_set(tmp_path / "set", [Rows(30, stated)])
    recorded = episode.read(import_episode(LeRobotData(root), 0, tmp_path / "out", MAP))
    stamps = recorded.cycle("PSM1")["stamp_ns"]
    exact = [SECOND + round(k * SECOND / hz) for k in range(30)]
    np.testing.assert_array_equal(stamps, exact)
    assert numbers_of(tmp_path / "out") == list(range(30))


@pytest.mark.parametrize("stated", [0, -5, "fast", 1e9, float("nan")])
def test_what_is_no_rate_is_refused(stated: Any, tmp_path: Path) -> None:
    root = write_set(tmp_path / "set", [Rows(4, 10)], camera=None)
    info = json.loads((root / "meta/info.json").read_text())
    (root / "meta/info.json").write_text(json.dumps({**info, "fps": stated}))
    with pytest.raises(EpisodeError, match="no LeRobot data set"):
        LeRobotData(root)


def with_hole(rows: Rows) -> None:
    """The timestamps jump by 3 s, the other statements go on."""
    rows.columns["timestamp"] = [
        t + 3.0 * (k >= 20) for k, t in enumerate(rows.columns["timestamp"])
    ]


def with_other_rate(rows: Rows) -> None:
    rows.columns["timestamp"] = [2 * t for t in rows.columns["timestamp"]]


def with_empty(rows: Rows) -> None:
    rows.columns["timestamp"][5] = None


def with_twice(rows: Rows) -> None:
    rows.columns["frame_index"][5] = 4


def short_video(rows: Rows) -> None:
    del rows.video_frames[-1]


def with_null(rows: Rows) -> None:
    rows.columns["observation.state"] = [*rows.columns["observation.state"][:-1], None]


def with_nan(rows: Rows) -> None:
    rows.columns["observation.state"] = [[float("nan")] * 5, *rows.columns["observation.state"][1:]]


DISAGREE: list[tuple[Any, str]] = [
    (with_hole, r"row 20: timestamp says 5\.000 s, frame_index at 10 Hz 2\.000 s"),
    (with_other_rate, "row 1: timestamp says 0.200 s"),
    (with_empty, "row 5: timestamp is empty"),
    (with_twice, "frame_index 4 is there twice"),
    (short_video, r"cam: 1 of 40 would be lost \(1 rows behind the end of the video"),
    (with_null, "1 of 40 would be lost .*empty value"),
    (with_nan, "1 of 40 would be lost .*no number"),
]


@pytest.mark.parametrize(
    ("change", "said", "version"),
    [
        pytest.param(*each, version, marks=[] if (n + k) % 2 == 0 else pytest.mark.full)
        for n, each in enumerate(DISAGREE)
        for k, version in enumerate(["v2.1", "v3.0"])
    ],
)
def test_two_statements_that_disagree_are_refused(
    change: Any, said: str, version: str, tmp_path: Path
) -> None:
    good, rows = Rows(40, 10), Rows(40, 10)
    change(rows)
    root = write_set(tmp_path / "set", [good, rows], version)
    data = LeRobotData(root)
    import_episode(data, 0, tmp_path / "good", MAP)
    assert numbers_of(tmp_path / "good") == list(range(40))
    with pytest.raises(EpisodeError, match=said):
        import_episode(data, 1, tmp_path / "out", MAP)
    assert not list(tmp_path.glob("out*"))


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_frames_that_all_statements_lack_leave_a_gap_of_time(version: str, tmp_path: Path) -> None:
    rows = Rows(40, 10)
    kept = [k for k in range(40) if not 10 <= k < 15]
    for name, values in rows.columns.items():
        rows.columns[name] = [values[k] for k in kept]
    rows.count = len(kept)
    root, ledger = write_set(tmp_path / "set", [Rows(40, 10), rows], version), Ledger()
    folder = import_episode(LeRobotData(root), 1, tmp_path / "out", MAP, ledger)
    stamps = episode.read(folder).cycle("PSM1")["stamp_ns"]
    np.testing.assert_array_equal(stamps, [SECOND + k * SECOND // 10 for k in kept])
    assert numbers_of(folder) == kept
    assert any("5 frames are missing, the first behind frame 9" in w for w in ledger.assumed)


def test_rows_in_another_order_and_jitter_keep_their_pictures(tmp_path: Path) -> None:
    rows = Rows(40, 10)
    rows.columns["timestamp"] = [k / 10 + 0.004 * (k % 3) for k in range(40)]
    order = np.random.default_rng(3).permutation(40)
    for name, values in rows.columns.items():
        rows.columns[name] = [values[k] for k in order]
    root = write_set(tmp_path / "set", [rows])
    folder = import_episode(LeRobotData(root), 0, tmp_path / "out", MAP)
    assert numbers_of(folder) == list(range(40))
    cycle = episode.read(folder).cycle("PSM1")
    np.testing.assert_allclose(cycle.vector("p_tip"), [tip(k / 10) for k in range(40)], atol=1e-7)
    jitter = (cycle["stamp_ns"] - SECOND) * 1e-9 - np.arange(40) / 10
    np.testing.assert_allclose(jitter, 0.004 * (np.arange(40) % 3), atol=1e-6)


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_instructions_of_every_episode_arrive(version: str, tmp_path: Path) -> None:
    tasks = ["pick the needle", "pass the needle", "tie a knot"]
    episodes = [Rows(20, 10) for _ in tasks]
    for number, rows in enumerate(episodes):
        rows.columns["task_index"] = [number] * 20
    episodes[2].columns["task_index"] = [1] * 8 + [2] * 12
    root = write_set(tmp_path / "set", episodes, version, tasks=tasks, camera=None)
    made = []
    for number in range(3):
        folder = import_episode(LeRobotData(root), number, tmp_path / str(number), MAP)
        made.append(episode.read(folder))
    said = [recorded.manifest["run"]["instruction"] for recorded in made]
    assert said == ["pick the needle", "pass the needle", "pass the needle; tie a knot"]
    stages = [(stage["name"], stage["begin_ns"]) for stage in made[2].stages]
    assert stages == [("pass the needle", SECOND), ("tie a knot", SECOND + 800_000_000)]


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_pictures_in_the_table_arrive(version: str, tmp_path: Path) -> None:
    root = write_set(tmp_path / "set", [Rows(20, 10), Rows(20, 10)], version, camera="image")
    ledger = Ledger()
    folder = import_episode(LeRobotData(root), 1, tmp_path / "out", MAP, ledger)
    assert numbers_of(folder) == list(range(20)) and ledger.kept["cam"] == 20


@pytest.mark.parametrize(
    "names",
    [
        {"x": 0, "y": 1, "z": 2, "roll": 3, "jaw": 4},
        {"jaw": 4, "roll": 3, "z": 2, "y": 1, "x": 0},
        {"motors": NAMES},
        {"arm": ["x", "y", "z"], "tool": ["roll", "jaw"]},
        None,
        ["x", "y"],
    ],
)
def test_names_of_every_form_lead_to_their_columns(names: Any, tmp_path: Path) -> None:
    root = write_set(tmp_path / "set", [Rows(20, 10)], names=names, camera=None)
    prefix = {"x": "arm/", "y": "arm/", "z": "arm/", "roll": "tool/", "jaw": "tool/"}
    grouped = isinstance(names, dict) and "tool" in names
    wanted: dict[str, Any] = {n: (prefix[n] + n if grouped else n) for n in NAMES}
    if names is None or (len(names) == 2 and not grouped):
        wanted = {n: i for i, n in enumerate(NAMES)}
    stated = {"arms": {"PSM1": {"measured": wanted}}}
    folder = import_episode(LeRobotData(root), 0, tmp_path / "out", stated)
    found = episode.read(folder).cycle("PSM1")
    np.testing.assert_allclose(found.vector("p_tip"), [tip(k / 10) for k in range(20)], atol=1e-7)
    np.testing.assert_allclose(found["jaw"], 0.2)


@pytest.mark.parametrize(
    ("info", "said"),
    [
        ({"codebase_version": "v4.0"}, "'v4.0'; this version reads v2.0, v2.1, v3.0"),
        ({"data_path": "../../secret.parquet"}, "leads out of the data set"),
        ({"data_path": "/etc/{episode_index}"}, "leads out of the data set"),
        ({"data_path": "{nonsense}.parquet"}, "data_path is '{nonsense}.parquet'"),
        ({"video_path": None}, "video_path is None"),
    ],
)
def test_a_description_that_cannot_be_followed_is_refused(
    info: dict[str, Any], said: str, tmp_path: Path
) -> None:
    root = write_set(tmp_path / "set", [Rows(20, 10)], **info)
    with pytest.raises(EpisodeError, match=said):
        import_episode(LeRobotData(root), 0, tmp_path / "out", MAP)


def test_rows_that_are_not_as_many_as_stated_are_refused(tmp_path: Path) -> None:
    root = write_set(tmp_path / "set", [Rows(20, 10)], camera=None)
    lines = root / "meta/episodes.jsonl"
    lines.write_text(lines.read_text().replace('"length": 20', '"length": 21'))
    with pytest.raises(EpisodeError, match="holds 20 rows of episode 0; meta/episodes says 21"):
        import_episode(LeRobotData(root), 0, tmp_path / "out", MAP)


def test_names_of_cameras_stay_in_the_folder(tmp_path: Path) -> None:
    root = write_set(tmp_path / "set", [Rows(20, 10)], "v2.1", camera="image")
    info = json.loads((root / "meta/info.json").read_text())
    info["features"]["../../evil"] = info["features"].pop("observation.images.cam")
    (root / "meta/info.json").write_text(json.dumps(info))
    import pyarrow.parquet as pq

    file = root / "data/chunk-000/episode_000000.parquet"
    table = pq.read_table(file)
    renamed = [n.replace("observation.images.cam", "../../evil") for n in table.column_names]
    pq.write_table(table.rename_columns(renamed), file)
    folder = import_episode(LeRobotData(root), 0, tmp_path / "in" / "out", MAP)
    assert episode.read(folder).cameras == ["evil"]


TAGS = ["-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709"]
RED, GREEN = (200, 30, 40), (30, 160, 60)


CODED: list[tuple[str, list[str]]] = [
    ("null", []),
    ("scale=out_color_matrix=bt709:out_range=tv", [*TAGS, "-color_range", "tv"]),
    ("scale=out_color_matrix=bt709:out_range=pc", [*TAGS, "-color_range", "pc"]),
    (
        "scale=out_color_matrix=bt601:out_range=pc",
        ["-colorspace", "smpte170m", "-color_range", "pc"],
    ),
    ("scale=out_color_matrix=bt2020:out_range=tv", ["-colorspace", "bt2020nc"]),
]


@pytest.mark.parametrize(
    ("filters", "tags", "turn"),
    [
        pytest.param(*coded, turn, marks=[] if (n - k) % 4 == 0 else pytest.mark.full)
        for n, coded in enumerate(CODED)
        for k, turn in enumerate([0, 90, 180, 270])
    ],
)
def test_colours_and_rotation_follow_the_tags(
    filters: str, tags: list[str], turn: int, tmp_path: Path
) -> None:
    image = np.zeros((48, 64, 3), np.uint8)
    image[:, :32], image[:, 32:] = RED, GREEN
    root = write_set(tmp_path / "set", [Rows(10, 10)])
    path = root / "videos/observation.images.cam/episode_000000.mp4"
    write_video(path, [image] * 10, 10, filters, tags)
    if turn:
        import subprocess

        plain = path.rename(path.with_suffix(".plain.mp4"))
        said = subprocess.run(["ffmpeg", "-version"], capture_output=True, text=True, check=True)
        old = int(said.stdout.split()[2].split(".")[0]) < 6
        given = [] if old else ["-display_rotation", str(-turn)]
        kept = ["-metadata:s:v", f"rotate={turn}"] if old else []
        copied = [*given, "-i", str(plain), "-c", "copy", *kept, str(path)]
        subprocess.run(["ffmpeg", "-v", "error", *copied], check=True)
    size = (48, 64) if turn in (0, 180) else (64, 48)
    shown_by_ffmpeg = ffmpeg_shows(path, size)
    folder = import_episode(LeRobotData(root), 0, tmp_path / "out", MAP)
    (shown,) = video_file.grab(episode.read(folder).video("cam").path, [3])
    assert shown.shape[:2] == size
    rows, columns = np.array([size[0] // 4, 3 * size[0] // 4]), np.array([size[1] // 4] * 2)
    if turn in (0, 180):
        rows, columns = rows[:1].repeat(2), np.array([size[1] // 4, 3 * size[1] // 4])
    for row, column in zip(rows, columns, strict=True):
        by_ffmpeg = shown_by_ffmpeg[row, column].astype(int)
        true = RED if np.abs(by_ffmpeg - RED).max() < 12 else GREEN
        assert np.abs(shown[row, column].astype(int) - true).max() <= 3


def ffmpeg_shows(path: Path, size: tuple[int, int]) -> Any:
    """A picture as FFmpeg's own program turns it."""
    import subprocess

    asked = ["ffmpeg", "-v", "error", "-i", str(path), "-frames:v", "1", "-f", "rawvideo"]
    done = subprocess.run([*asked, "-pix_fmt", "rgb24", "-"], capture_output=True, check=True)
    return np.frombuffer(done.stdout, np.uint8).reshape(*size, 3)


def test_an_import_without_joints_is_exported_in_every_format(tmp_path: Path) -> None:
    root = write_set(tmp_path / "set", [Rows(40, 20)])
    folder = import_episode(LeRobotData(root), 0, tmp_path / "episode", MAP)
    options = ExportOptions(executor="serial", splits={"train": 1.0}, fps=20)
    for name in ("lerobot_v21", "lerobot_v30", "robomimic", "act", "diffusion_policy", "mcap"):
        report = datasets.load(name).write([folder], tmp_path / name, options)
        assert report.ok, (name, report)


def test_imports_alone_are_evaluated_and_shown_without_what_is_missing(tmp_path: Path) -> None:
    root = write_set(tmp_path / "set", [Rows(40, 20), Rows(40, 20)])
    data = LeRobotData(root)
    for number in range(2):
        import_episode(data, number, tmp_path / "episodes" / str(number), MAP)
    evaluate = argparse.ArgumentParser()
    command_evaluate.add_arguments(evaluate, "evaluate")
    words = [str(tmp_path / "episodes"), "--out", str(tmp_path / "evaluation")]
    assert command_evaluate.main(evaluate.parse_args(words), "evaluate") == 0
    drawn = {file.stem for file in (tmp_path / "evaluation" / "figures").iterdir()}
    assert "smoothness" in drawn and "rcm_deviation" not in drawn
    assert (tmp_path / "evaluation" / "report.html").is_file()
    film = argparse.ArgumentParser()
    make_film.add_arguments(film, "film")
    words = [str(tmp_path / "episodes" / "0"), "--out", str(tmp_path / "film.mp4")]
    assert make_film.main(film.parse_args(words), "film") == 0
    assert (tmp_path / "film.mp4").stat().st_size > 0


def test_an_import_is_viewed_judged_and_cut(tmp_path: Path) -> None:
    """It has no joints, no cycles of a controller and no task of ours."""
    root = write_set(tmp_path / "set", [Rows(40, 20)])
    folder = import_episode(LeRobotData(root), 0, tmp_path / "episode", MAP)
    pages = LabelPages([folder], "A")
    assert 'id="video0"' in pages.page(1)
    stamps = episode.read(folder).cycle("PSM1")["stamp_ns"]
    trim = {"begin_ns": str(stamps[5]), "end_ns": str(stamps[30])}
    pages.save(1, {"success": True, "note": "", "stages": [], "trim": trim})
    assert pages.badge(1)[1] == "success"
    options = ExportOptions(executor="serial", splits={"train": 1.0}, fps=20)
    report = datasets.load("lerobot_v30").write([folder], tmp_path / "exported", options)
    assert report.ok
    info = json.loads((tmp_path / "exported" / "meta" / "info.json").read_text())
    assert 20 < info["total_frames"] <= 26


@pytest.mark.parametrize(("stated", "fps"), [(12.5, 12), (15, 15), (10, 20)])
def test_an_import_of_any_rate_is_exported_at_another(
    stated: float, fps: int, tmp_path: Path
) -> None:
    """Its samples are further apart than a controller's cycles may be."""
    import pyarrow.parquet as pq

    root = write_set(tmp_path / "set", [Rows(30, stated)])
    folder = import_episode(LeRobotData(root), 0, tmp_path / "episode", MAP)
    options = ExportOptions(executor="serial", splits={"train": 1.0}, fps=fps)
    assert datasets.load("lerobot_v21").write([folder], tmp_path / "out", options).ok
    table = pq.read_table(next((tmp_path / "out" / "data").rglob("*.parquet")))
    seconds = (np.array(table.column("timing.grid_ns").to_pylist()) - SECOND) * 1e-9
    state = np.array(table.column("observation.state").to_pylist())[:, :3]
    assert len(state) > 0.8 * 30 * fps / stated
    np.testing.assert_allclose(state, [tip(t) for t in seconds], atol=2e-4)
