"""Whether a moved part of the chain from joints to pixels is noticed, named and corrected."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import surg_core
from helpers.endoscope_files import copied_cell
from helpers.perception.drift_bench import (
    SCOPE,
    TOOL,
    DriftBench,
    Motion,
    Moved,
    look_without_pictures,
)
from helpers.results.perception_results import PAGE
from helpers.sim.board_views import BARREL
from helpers.sim.unknown_scene import UnknownScene
from surg_cli.graph import endoscope
from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_core.lens_file import load_lens
from surg_core.pictures.eye_projection import EyeProjection
from surg_perception.calibration.result_files import LEFT, RIGHT
from surg_perception.calibration.tip_finder import NotSeen
from surg_perception.drift.drift_state import MOVED, STEADY, UNKNOWN, DriftState, state_of
from surg_perception.drift.drift_watch import SHAFT, DriftWatch
from surg_perception.drift.seen_shafts import THROWN, SeenShaft, stacked
from surg_perception.drift.shaft_finder import find_shaft, lit_part
from surg_perception.drift.stated_parts import stated_parts
from surg_sim.physics.patient_settings import SETTINGS
from surg_sim.physics.pose_error import PoseError

CALIBRATIONS = 2
SINCE, SECONDS = 12.0, 20.0
"""When a part moves, and when the motion ends [s]."""


@pytest.fixture(scope="module")
def benches(tmp_path_factory: pytest.TempPathFactory) -> list[DriftBench]:
    """Cells of several calibrations."""
    return [DriftBench(tmp_path_factory.mktemp("cell"), 30 + k) for k in range(CALIBRATIONS)]


def watch_of(cell: surg_core.Cell, take: Callable[[SeenShaft], None] | None = None) -> DriftWatch:
    folder = cell.folder / "calibration"
    lenses = [load_lens(folder / e) for e in (LEFT, RIGHT)]
    return DriftWatch(cell, lenses, stated_parts(cell), take)


def played(
    bench: DriftBench, seed: int, moved: Moved, scope: bool = True, seconds: float = SECONDS
) -> list[tuple[float, DriftState]]:
    """States during a motion in which something moves after `SINCE`."""
    motion, rng = Motion(bench.chain, seed, seconds, scope), np.random.default_rng(seed)
    watch, states = watch_of(bench.cell), []
    for at in motion.t:
        now = moved if at >= SINCE else Moved()
        if look_without_pictures(watch, bench, motion, float(at), now, rng):
            states.append((float(at), state_of(watch.verdict, watch.unseen)))
    return states


def drawn(rng: np.random.Generator, size: float) -> np.ndarray:
    way = rng.normal(size=3)
    return np.asarray(size * way / np.linalg.norm(way))


BUMPS: dict[str, tuple[str, Callable[[np.random.Generator], Moved]]] = {
    "camera, 1 mm": (
        "camera",
        lambda rng: Moved(camera=np.r_[np.zeros(3), drawn(rng, 0.001)]),
    ),
    "camera, 0.5 deg": (
        "camera",
        lambda rng: Moved(camera=np.r_[drawn(rng, np.radians(0.5)), np.zeros(3)]),
    ),
    "camera, 3 mm and 2 deg": (
        "camera",
        lambda rng: Moved(camera=np.r_[drawn(rng, np.radians(2.0)), drawn(rng, 0.003)]),
    ),
    "camera, 20 mm and 10 deg": (
        "camera",
        lambda rng: Moved(camera=np.r_[drawn(rng, np.radians(10.0)), drawn(rng, 0.02)]),
    ),
    "base of PSM1, 3 mm": (
        f"base of {TOOL}",
        lambda rng: Moved(base={TOOL: np.r_[np.zeros(3), drawn(rng, 0.003)]}),
    ),
    "base of ECM, 3 mm": (
        f"base of {SCOPE}",
        lambda rng: Moved(base={SCOPE: np.r_[np.zeros(3), drawn(rng, 0.003)]}),
    ),
    "lens, 6 px": (
        "lens of left",
        lambda rng: Moved(lens={0: 6.0 * np.array([np.cos(w := rng.uniform(0, 6.3)), np.sin(w)])}),
    ),
    "tool, 3 mm and 1 deg": (
        f"tool of {TOOL}",
        lambda rng: Moved(tool=np.r_[drawn(rng, np.radians(1.0)), drawn(rng, 0.003)]),
    ),
    "lag, 50 ms": ("lag", lambda rng: Moved(lag=0.05)),
    "lag, 150 ms": ("lag", lambda rng: Moved(lag=0.15)),
}

SMALL = ("camera, 1 mm", "camera, 0.5 deg")
"""Noticed when they turn or shift what is seen; rarely named in a few seconds."""


@pytest.mark.parametrize("name", BUMPS)
def test_a_bump_is_noticed_and_named(name: str, benches: list[DriftBench], full: bool) -> None:
    cause, made = BUMPS[name]
    count = 6 if full else 1
    soon = right = wrong = before = 0
    for seed in range(count):
        moved = made(np.random.default_rng(1000 + seed))
        states = played(benches[seed % CALIBRATIONS], seed, moved)
        before += any(state.word == MOVED for at, state in states if at < SINCE)
        soon += any(state.word == MOVED for at, state in states if SINCE <= at < SINCE + 8.0)
        last = states[-1][1]
        right += last.cause == cause
        wrong += last.word == MOVED and cause not in (last.cause or last.reason)
    print(
        f"{name}: noticed {soon} of {count}, named {right}, another named {wrong}, early {before}"
    )
    assert before == 0
    if name not in SMALL:
        assert soon >= 0.95 * count
        assert wrong <= 0.2 * count


def test_while_nothing_moves_nothing_is_said(benches: list[DriftBench], full: bool) -> None:
    shown = 0
    for seed in range(6 if full else 2):
        for scope in (False, True):
            states = played(benches[seed % CALIBRATIONS], 500 + seed, Moved(), scope)
            assert len(states) > 3 * SECONDS
            assert not any(state.word == MOVED for _, state in states)
            assert Counter(state.word for _, state in states).most_common(1)[0][0] == STEADY
            shown += len(states)


def test_a_still_endoscope_does_not_tell_a_camera_from_a_base(benches: list[DriftBench]) -> None:
    moved = Moved(camera=np.array([0.0, 0.0, 0.0, 0.002, 0.001, 0.0]))
    last = played(benches[0], 4, moved, scope=False)[-1][1]
    assert (last.word, last.cause) == (MOVED, "")
    assert "turn the endoscope" in last.reason and "base of ECM" in last.reason


# --- pictures -------------------------------------------------------------------------------------


def bar(offset: float, turn: float, shade: int, half: float = 9.0) -> np.ndarray:
    """A picture (240, 320) with a straight bar, `offset` px beside a line and turned [deg]."""
    rng = np.random.default_rng(int(10 * abs(offset)) + shade)
    wall = cv2.GaussianBlur(rng.uniform(80, 160, (240, 320)).astype(np.float32), (0, 0), 3.0)
    big = cv2.resize(wall, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
    way = np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn))])
    across = np.array([-way[1], way[0]])
    middle = np.array([160.0, 120.0 + offset])
    ends = [middle - 260 * way, middle + 260 * way]
    rim = np.array([ends[0] - half * across, ends[1] - half * across, ends[1] + half * across,
                    ends[0] + half * across])  # fmt: skip
    cv2.fillPoly(
        big, [np.round(((rim + 0.5) * 4 - 0.5) * 16).astype(np.int32)], shade, cv2.LINE_AA, 4
    )
    small = cv2.resize(big, (320, 240), interpolation=cv2.INTER_AREA)
    return (small + rng.normal(scale=2.0, size=small.shape)).astype(np.float32)


AXIS = np.column_stack([np.linspace(60, 260, 28), np.full(28, 120.0)])
HALF = np.full(28, 11.0)


@pytest.mark.parametrize("shade", [30, 230])
@pytest.mark.parametrize(("offset", "turn"), [(0.0, 0.0), (7.3, -3.0), (-31.6, 6.0), (44.2, 9.0)])
def test_a_bar_is_found_to_a_fraction_of_a_pixel(offset: float, turn: float, shade: int) -> None:
    picture = bar(offset, turn, shade)
    seen = find_shaft(picture, np.ones(picture.shape, dtype=bool), AXIS, HALF)
    x = np.interp(seen.at, np.arange(28), AXIS[:, 0])
    true = offset + np.tan(np.radians(turn)) * (x - 160.0)
    np.testing.assert_allclose(seen.offsets * seen.normals[:, 1], true, atol=0.35)
    assert seen.sd < 0.2


def test_what_is_no_shaft_is_not_found() -> None:
    lit = np.ones((240, 320), dtype=bool)
    wall = bar(1000.0, 0.0, 30)
    two = np.minimum(bar(-40.0, 0.0, 30), bar(40.0, 0.0, 30))
    cases = {
        "no shaft stands out": (wall, lit, AXIS),
        "two shafts": (two, lit, AXIS),
        "not before the eye": (wall, lit, np.full((28, 2), np.nan)),
        "no shaft": (bar(0.0, 0.0, 30), ~lit, AXIS),
    }
    for said, (picture, seen, axis) in cases.items():
        with pytest.raises(NotSeen, match=said):
            find_shaft(picture, seen, axis, HALF)


def test_the_round_picture_is_found_although_a_dark_shaft_crosses_it() -> None:
    y, x = np.mgrid[:240, :320]
    inside = np.hypot(x - 160, y - 120) < 110
    lit = lit_part(np.where(inside, bar(0.0, 0.0, 5), 0.0).astype(np.float32))
    assert not (lit & ~inside).any()
    assert lit[np.hypot(x - 160, y - 120) < 90].all()


def looked(bench: DriftBench, motion: Motion, pictures: Callable[[float], tuple]) -> DriftState:
    watch = watch_of(bench.cell)
    for at in motion.t[::3]:
        watch.look(float(at), pictures(float(at)), motion.joints)
    return state_of(watch.verdict, watch.unseen)


def test_what_shows_nothing_is_no_alarm(benches: list[DriftBench]) -> None:
    bench, rng = benches[0], np.random.default_rng(2)
    motion, other = (Motion(bench.chain, seed, 4.0, False) for seed in (3, 77))
    first = bench.pair(motion, 0.0, Moved())
    black = tuple(np.zeros_like(each) for each in first)
    away = bench.pair(motion, 0.0, Moved(camera=np.array([0.0, 0.0, 0.0, 0.5, 0.0, 0.0])))

    def noisy(at: float) -> tuple:
        return tuple(each + rng.integers(0, 3, each.shape).astype(np.uint8) for each in away)

    cases: dict[str, Callable[[float], tuple]] = {
        "stand still": lambda at: first if at else away,
        "no shaft stands out": noisy,
        "pictures stand still": lambda at: black,
    }
    for said, pictures in cases.items():
        state = looked(bench, motion, pictures)
        assert state.word == UNKNOWN and said in state.sentence(), state
    # An instrument that the joints do not drive moves otherwise than they say.
    state = looked(bench, motion, lambda at: bench.pair(other, at, Moved()))
    assert state.word != MOVED, state
    watch = watch_of(bench.cell)
    watch.look(0.0, first, lambda arm, at: None)
    assert "no joints of ECM" in state_of(watch.verdict, watch.unseen).sentence()


def test_where_the_lens_was_not_measured_nothing_is_seen(
    benches: list[DriftBench], monkeypatch: pytest.MonkeyPatch
) -> None:
    bench, rng = benches[0], np.random.default_rng(0)
    motion = Motion(bench.chain, 3, 4.0, True)
    kept = list[SeenShaft]()
    watch = watch_of(bench.cell, kept.append)
    for at in motion.t:
        look_without_pictures(watch, bench, motion, float(at), Moved(), rng)
    x = np.zeros(watch.rows.steps)
    for part in stated_parts(bench.cell):
        x[part.at] = 1e4 * (part.name == "lens of left")
    left = [each for each in kept if np.isfinite(each.pixels[0]).all()]
    rows = watch.rows.at(stacked(left), x)
    assert not rows.A.any() and (rows.r == THROWN).all()
    monkeypatch.setattr(EyeProjection, "plane_of", lambda self, pixels: np.nan * pixels)
    watch = watch_of(bench.cell)
    assert not any(
        look_without_pictures(watch, bench, motion, float(at), Moved(), rng) for at in motion.t
    )
    assert "lens was not measured" in state_of(watch.verdict, watch.unseen).reason


@pytest.mark.parametrize("seed", range(4))
def test_derivatives_are_those_of_a_shaft_that_steps_by_centimetres(
    seed: int, benches: list[DriftBench]
) -> None:
    """Against differences, where the shaft is seen as large steps of all parts put it."""
    bench, rng, kept = benches[0], np.random.default_rng(seed), list[SeenShaft]()
    watch, motion = watch_of(bench.cell, kept.append), Motion(bench.chain, seed, 3.0, True)
    for at in motion.t:
        look_without_pictures(watch, bench, motion, float(at), Moved(), rng)
    rows, parts = watch.rows, stated_parts(bench.cell)
    sd = np.concatenate([np.sqrt(np.diag(part.moved)) for part in parts])
    x = 0.2 * rng.normal(size=len(sd)) * sd
    ends = rows.moved(stacked(kept), x)
    for shaft, (low, high) in zip(kept, ends, strict=True):
        for eye, view in enumerate(rows.eyes):
            shaft.pixels[eye] = view.pixels(np.linspace(low, high, 5)[[1, 3]])
            shaft.pixels[eye] += rows.of_lens(eye, x)

    def off(steps: np.ndarray) -> np.ndarray:
        found = rows.at(stacked(kept), steps)
        return np.asarray(found.r - found.A @ steps)

    found = rows.at(stacked(kept), x)
    seen = found.A.any(axis=2)
    assert seen.sum() >= 8
    np.testing.assert_allclose(off(x)[seen], 0.0, atol=1e-9)
    for number, one in enumerate(sd):
        step = np.zeros(len(sd))
        step[number] = 1e-5 * one
        slope = (off(x - step) - off(x + step))[seen] / 2e-5
        true = found.A[..., number][seen] * one
        assert np.abs(slope - true).max() < 0.02 * np.abs(found.A[seen] * sd).max()


def test_late_pictures_show_a_shaft_where_it_was(benches: list[DriftBench]) -> None:
    bench, rng, kept = benches[0], np.random.default_rng(3), list[SeenShaft]()
    watch, motion = watch_of(bench.cell, kept.append), Motion(bench.chain, 3, 10.0, True)
    for at in motion.t:
        look_without_pictures(watch, bench, motion, float(at), Moved(), rng)
    parts = stated_parts(bench.cell)
    x = np.zeros(parts[-1].at.stop)
    x[next(part.at for part in parts if part.kind == "lag")] = 0.15
    found = watch.rows.moved(stacked(kept), x)
    off, way = list[float](), list[float]()
    for shaft, there_V in zip(kept, found, strict=True):
        late, now = (
            bench.shaft(motion, shaft.stamp, moved, np.array(SHAFT))
            for moved in (Moved(lag=0.15), Moved())
        )
        off += np.linalg.norm(there_V - shaft.p_V - (late - now), axis=1).tolist()
        way += np.linalg.norm(late - now, axis=1).tolist()
    assert len(kept) > 40 and np.mean(way) > 0.001
    assert np.mean(off) < 0.04 * np.mean(way), (np.mean(off), np.mean(way))


def test_a_cell_that_nobody_calibrated_is_refused(
    benches: list[DriftBench], tmp_path: Path
) -> None:
    import shutil

    folder = tmp_path / "cell"
    shutil.copytree(benches[0].folder, folder)
    for name, said in (("base_PSM1", "bases --by touch"), ("camera_ECM", "handeye")):
        cell = surg_core.load_cell(folder)
        stated_parts(cell)
        files = [*folder.glob(f"calibration/{name}.yaml"), *folder.glob("calibration/base_*.yaml")]
        files[0].unlink()
        with pytest.raises(surg_core.ConfigError, match=said):
            stated_parts(surg_core.load_cell(folder))
        shutil.rmtree(folder)
        shutil.copytree(benches[0].folder, folder)


def test_a_calibrated_cell_with_both_eyes_is_watched(benches: list[DriftBench]) -> None:
    asked, both = endoscope.Pictures(2), endoscope.Endoscope(("left", "right"))
    watched = {"depth": False, "marks": False, "drift": True, "cell": str(benches[0].folder)}
    assert endoscope.eyes_of(asked, both, benches[0].cell) == watched
    assert endoscope.eyes_of(asked, endoscope.Endoscope(("left",)), benches[0].cell) is None
    bare = surg_core.load_cell(paths.CELLS / "sim_two_arms")
    assert endoscope.eyes_of(asked, both, bare) is None


class RenderedDrift:
    """The simulator's pictures of a calibrated cell while the tip moves before the endoscope."""

    def __init__(self, folder: Path, name: str, seed: int) -> None:
        setting = replace(
            SETTINGS[name],
            tool_error=None,  # else the tool's file is wrong from the start, and the watch says so
            base_error=PoseError(0.008, np.radians(3.0), seed=seed + 1),
            camera_error=PoseError(0.003, np.radians(2.0), seed=seed + 50),
            lens=BARREL,
        )
        self.scene = UnknownScene(surg_core.load_cell(copied_cell(folder)), setting, seed)
        self.scene.chain.write(self.scene.cell.folder / "calibration")
        self.cell = surg_core.load_cell(self.scene.cell.folder)
        self.motion = Motion(self.scene.chain, seed, SECONDS, True)

    def pictures(self, at: float) -> tuple[np.ndarray, np.ndarray]:
        model, qpos = self.scene.world.model, self.scene.qpos
        for arm in self.cell.arms.values():
            q = self.motion.joints(arm.name, at)
            assert q is not None
            for joint, angle in zip(arm.robot.joint_names, q, strict=True):
                qpos[model.joint(f"{arm.name}_robot_{joint}").qposadr[0]] = angle
        drawn = self.scene.renderer.render(qpos)
        return drawn["left"], drawn["right"]

    def states(self, step: np.ndarray) -> list[tuple[float, DriftState]]:
        """States while the camera is believed where it was before this step after `SINCE`."""
        watch, states = watch_of(self.cell), []
        held = watch.held
        assert held.X_FV is not None
        X_VV = surg_core.make_pose(step[3:])
        X_VV[:3, :3] = Rotation.from_rotvec(step[:3]).as_matrix()
        for at in self.motion.t:
            if at >= SINCE:
                watch.held = replace(held, X_FV=held.X_FV @ np.linalg.inv(X_VV))
            if watch.look(float(at), self.pictures(float(at)), self.motion.joints):
                states.append((float(at), state_of(watch.verdict, watch.unseen)))
        return states


@pytest.mark.full
def test_a_bump_in_the_simulators_pictures(tmp_path: Path) -> None:
    step = np.r_[np.radians([1.0, 1.0, 1.4]), 0.003, 0.003, -0.002]
    scenes, noticed, named = 0, 0, 0
    for seed in (1, 100, 200, 400, 600):
        (tmp_path / str(seed)).mkdir()
        made = RenderedDrift(tmp_path / str(seed), "phantom", 40 + seed)
        for moved in (np.zeros(6), step):
            states = made.states(moved)
            bumped = [state for at, state in states if at >= SINCE and moved.any()]
            assert not any(s.word == MOVED for _, s in states if s not in bumped), seed
        scenes += 1
        noticed += any(state.word == MOVED for state in bumped)
        named += bumped[-1].cause == "camera"
        made.scene.renderer.close()
    PAGE.note("drift, rendered: camera, 4.7 mm and 2 deg", scenes, f"{noticed}, {named}, 0")
    assert noticed >= 4


# --- the command ----------------------------------------------------------------------------------


def test_a_step_that_accepts_nothing_and_a_missing_episode_are_refused(
    surg: Callable[..., int], benches: list[DriftBench], tmp_path: Path
) -> None:
    folder = benches[0].folder
    for words, said in (
        (("drift",), "--from EPISODE is missing"),
        (("check", "--accept"), "--accept goes with drift"),
        (("drift", "--from", tmp_path / "none"), "none"),
    ):
        with pytest.raises(CliError, match=said) as refused:
            surg("calibrate", folder, *words)
        assert refused.value.code in (1, 2)
