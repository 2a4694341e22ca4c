"""Whether an accepted correction is as good as a fresh calibration, and touches nothing else."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import surg_core
from helpers.perception import drift_bench
from helpers.perception.drift_bench import (
    SCOPE,
    TOOL,
    DriftBench,
    Motion,
    Moved,
)
from helpers.perception.drift_recovery import ORIGIN, Recovery, bump
from helpers.recording.stereo_recording import record_pairs
from helpers.results.perception_results import PAGE
from surg_cli.host.terminal import CliError
from surg_core.base_file import load_base
from surg_core.camera_file import load_camera
from surg_perception.drift import drift_step, whole_recording
from surg_perception.drift.drift_state import MOVED, STEADY, UNKNOWN, DriftState

PARTS = {"camera": 24, f"base of {SCOPE}": 20, f"base of {SCOPE} or base of {TOOL}": 20}
"""What is named, and how many cells it is tried in."""


def test_an_accepted_bump_leaves_what_a_fresh_calibration_leaves(
    tmp_path: Path, full: bool
) -> None:
    rows, count = [], 0
    for cause, cells in PARTS.items():
        for seed in range(3, 3 + (cells if full else 1)):
            part = f"base of {TOOL}" if TOOL in cause else cause
            made = Recovery(tmp_path / f"{part}{seed}", seed, bump(seed, part), cause)
            fresh, bumped = made.off(Moved()), made.off(made.moved)
            count += 1
            try:
                written = made.accept()
            except surg_core.ConfigError as why:
                print(cause, seed, why)
                assert "Record" in str(why)
                continue
            assert written[0] == (made.camera if cause == "camera" else made.base)
            rows.append([fresh, bumped, made.off(made.moved)])
            print(cause, seed, np.round(rows[-1], 3).tolist())
    fresh, bumped, after = np.median(rows, axis=0)
    print(f"{len(rows)} of {count}, median: {fresh}, {bumped}, {after}")
    print("95 %:", *np.percentile(rows, 95, axis=0))
    said = (
        f"{fresh[0]:.3f} mm, {fresh[1]:.3f}° fresh, {after[0]:.3f} mm, {after[1]:.3f}° after; "
        f"joints beside picture {fresh[2]:.3f}, {after[2]:.3f} mm"
    )
    PAGE.note("drift accepted after 60 s", count, f"{len(rows)}: {said}")
    if full:
        assert len(rows) >= 0.9 * count
        assert (after[1:] <= 1.2 * fresh[1:]).all() and after[0] <= 1.5 * fresh[0]
    assert after[0] < 0.15 and after[1] < 0.15 and bumped[0] > 1.0


def test_what_is_not_named_keeps_its_pose(tmp_path: Path) -> None:
    made = Recovery(tmp_path / "camera", 3, bump(3))
    X_FV, base = made.X_FV, load_base(made.base)
    made.accept()
    after = load_base(made.base)
    np.testing.assert_allclose(after.X_WB, base.X_WB, atol=1e-12)
    assert after.evidence.n == base.evidence.n and not np.allclose(made.X_FV, X_FV, atol=1e-3)
    surg_core.load_cell(made.bench.folder)
    made = Recovery(tmp_path / "base", 3, bump(3, f"base of {SCOPE}"), f"base of {SCOPE}")
    before = made.camera.read_bytes()
    assert made.accept() == [made.base] and made.camera.read_bytes() == before


def test_another_shaft_in_one_of_seven_pictures_changes_little(tmp_path: Path) -> None:
    made = Recovery(tmp_path / "cell", 6, bump(6), outliers=0.15)
    made.accept()
    after = made.off(made.moved)
    assert after[0] < 0.1 and after[1] < 0.1, after


@pytest.mark.parametrize(
    ("said", "changed"),
    [
        (r"Record \d+0 s of motion: the tip all over the view", {"seconds": 6.0}),
        ("There is nothing to accept", {"cause": ""}),
        ("There is nothing to accept", {"cause": f"camera or base of {SCOPE}"}),
        ("calibrate CELL stereo: measure the lenses", {"cause": "lens of left"}),
        ("nothing is seen since", {"moved": Moved(camera=np.array([0, 0, 0, 0.5, 0, 0]))}),
        ("no single step explains", {"moved": Moved(lens={0: np.array([0, 25.0])}, lag=0.2)}),
    ],
)
def test_what_cannot_be_accepted_is_refused_and_nothing_is_written(
    said: str, changed: dict[str, Any], tmp_path: Path
) -> None:
    made = Recovery(**{"folder": tmp_path / "cell", "seed": 3, "moved": bump(3)} | changed)
    before = {p: p.read_bytes() for p in made.bench.folder.rglob("*.yaml")}
    with pytest.raises(surg_core.ConfigError, match=said):
        made.accept()
    assert {p: p.read_bytes() for p in made.bench.folder.rglob("*.yaml")} == before


def test_another_part_than_the_one_that_moved_is_not_corrected(tmp_path: Path) -> None:
    made = Recovery(tmp_path / "cell", 3, bump(3), f"base of {SCOPE}")
    before = made.base.read_bytes()
    with pytest.raises(surg_core.ConfigError, match=r"does not explain .*: camera would"):
        made.accept()
    assert made.base.read_bytes() == before


def test_a_correction_begins_with_the_last_motion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = [(STEADY, 0.0), (MOVED, 3.0), (STEADY, 6.0), (MOVED, 8.0), (UNKNOWN, 8.5), (MOVED, 9.0)]
    states = [DriftState(word, since=at) for word, at in said]
    watch, pair = SimpleNamespace(verdict=None), SimpleNamespace()
    shown: list[float] = []

    def show(cell: Any, eyes: Any, every: Any, since: float, progress: Any) -> list[Any]:
        shown.append(since)
        return []

    monkeypatch.setattr(drift_step, "watched", lambda *_: [(watch, pair, s) for s in states])
    monkeypatch.setattr(drift_step, "RecordedEyes", lambda _: SimpleNamespace(lenses=()))
    monkeypatch.setattr(drift_step, "show", show)
    monkeypatch.setattr(drift_step.episode_reader, "read", lambda _: None)
    monkeypatch.setattr(drift_step, "_page", lambda *_: "")
    monkeypatch.setattr(drift_step, "accept", lambda c, s, lenses, look, origin: look(watch) or [])
    (tmp_path / "calibration" / "views").mkdir(parents=True)
    cell: Any = SimpleNamespace(folder=tmp_path)
    drift_step.drift(cell, tmp_path, ORIGIN, True)
    assert shown == [8.0]


# --- the command ----------------------------------------------------------------------------------


def test_a_recorded_bump_is_said_and_accepted(
    surg: Callable[..., int],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "cell").mkdir()
    bench = DriftBench(tmp_path / "cell", 33)
    motion = Motion(bench.chain, 5, 6.0, True)
    moved = Moved(camera=np.r_[np.radians([1.0, -1.5, 1.0]), 0.003, -0.002, 0.002])
    episode = bench.record(tmp_path / "episode", motion, moved)
    file = bench.folder / "calibration" / "camera_ECM.yaml"
    words = ("calibrate", bench.folder, "drift", "--from", episode)
    before = file.read_bytes()

    def at_the_end() -> str:
        (said,) = (x for x in capsys.readouterr().out.splitlines() if x.startswith("at the end"))
        return said

    assert surg(*words) == 0
    said = at_the_end()
    assert "moved: instruments are seen" in said and "camera" in said
    assert file.read_bytes() == before
    page = bench.folder / "calibration" / "views" / "drift.html"
    assert "data:image" in page.read_text() and page.stat().st_size > 20_000

    true = bench.chain.bench.X_FV @ surg_core.make_pose(moved.camera[3:])
    true[:3, :3] = (
        bench.chain.bench.X_FV[:3, :3] @ Rotation.from_rotvec(moved.camera[:3]).as_matrix()
    )

    def off(stated: Path) -> float:
        """How far a point 80 mm before the eye lies beside its place [mm]."""
        p = np.array([0.0, 0.0, 0.08, 1.0])
        believed = np.linalg.inv(true) @ load_camera(stated).X_FV @ p - p
        return 1e3 * float(np.linalg.norm(believed))

    first = off(file)
    with pytest.raises(CliError, match=r"Record \d+ s of motion"):
        surg(*words, "--accept")
    assert file.read_bytes() == before
    # What 6 s are worth is enough here: pictures of a minute take a minute to draw.
    monkeypatch.setattr(whole_recording, "SHIFT", 1e-3)
    monkeypatch.setattr(whole_recording, "TURN", np.radians(1.0))
    assert surg(*words, "--accept") == 0
    assert file.with_name("camera_ECM.yaml.previous").read_bytes() == before
    capsys.readouterr()
    surg_core.load_cell(bench.folder)  # nothing is stale
    assert surg(*words) == 0
    assert "at the end: steady" in at_the_end()
    print(f"80 mm before the eye: {first:.2f} mm off, then {off(file):.2f} mm")
    assert first > 3.0 and off(file) < 0.4
    with pytest.raises(CliError, match="nothing to accept"):
        surg(*words, "--accept")


@pytest.mark.parametrize("lacks", ["joints", "stamps", "an eye", "a covariance"])
def test_a_recording_that_cannot_tell_corrects_nothing(
    lacks: str, surg: Callable[..., int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cell").mkdir()
    bench = DriftBench(tmp_path / "cell", 33)
    motion, file = Motion(bench.chain, 5, 0.5, True), bench.folder / "calibration/camera_ECM.yaml"
    if lacks == "joints":  # what moves in the pictures is driven by nobody
        said = "cannot tell: no instrument has moved in view yet"
        pairs = iter([bench.pair(motion, float(at), Moved()) for at in motion.t])
        monkeypatch.setattr(bench, "pair", lambda *_: next(pairs))
        for q in motion._q.values():
            q[:] = q[0]
    elif lacks == "stamps":
        said = "no stamp in common"
        numbers, image = iter(range(1000)), drift_bench.image
        monkeypatch.setattr(drift_bench, "image", lambda _, each: image(next(numbers), each))
    elif lacks == "an eye":
        said, one = "has no video endoscope_right", drift_bench.EYES[:1]
        pairs = iter([bench.pair(motion, 0.0, Moved())[:1]] * 2)
        record_pairs(tmp_path / "episode", pairs, {}, cameras=one)
    else:
        said = "states a rotation only"
        (bench.folder / "calibration/base_ECM.yaml").unlink()
        file.write_text(
            "format: surg_camera/1\nquaternion: [0, 0, 0.6, 0.8]\nresidual: 0.004\nn: 15\n"
            "date: 2026-11-30\n"
        )
    episode = tmp_path / "episode"
    if not episode.exists():
        bench.record(episode, motion, bump(3))
    before = {p: p.read_bytes() for p in bench.folder.rglob("*.yaml")}
    with pytest.raises(CliError, match=said):
        surg("calibrate", bench.folder, "drift", "--from", episode, "--accept")
    assert {p: p.read_bytes() for p in bench.folder.rglob("*.yaml")} == before
