"""Whether an accepted correction is as good as a fresh calibration, and touches nothing else."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
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
    look_without_pictures,
)
from helpers.recording.stereo_recording import record_pairs
from surg_cli.host.terminal import CliError
from surg_core.base_file import load_base
from surg_core.camera_file import load_camera
from surg_core.lens_file import load_lens
from surg_perception.calibration.result_files import LEFT, RIGHT, Origin
from surg_perception.drift import whole_recording
from surg_perception.drift.accepted_drift import accept
from surg_perception.drift.drift_state import MOVED, DriftState
from surg_perception.drift.drift_watch import DriftWatch

ORIGIN = Origin("seen in a recording", "2026-11-30", "simulated")
SECONDS = 60.0
LOOKED_AT = np.array([[x, y, 0.08, 1.0] for x in (-0.015, 0, 0.015) for y in (-0.015, 0, 0.015)]).T
"""Points 80 mm before the eye [m]."""


def drawn(rng: np.random.Generator, low: float, high: float) -> np.ndarray:
    """A vector of any direction, small and large as often."""
    way, size = rng.normal(size=3), np.exp(rng.uniform(np.log(low), np.log(high)))
    return np.asarray(size * way / np.linalg.norm(way))


@dataclass
class Recovery:
    """A cell whose part moves, and a recording of it without pictures."""

    folder: Path
    seed: int
    moved: Moved
    cause: str = "camera"
    seconds: float = SECONDS
    outliers: float = 0.0

    def __post_init__(self) -> None:
        """Calibrate the cell."""
        self.folder.mkdir()
        self.bench = DriftBench(self.folder, 60 + self.seed)

    @property
    def camera(self) -> Path:
        return self.bench.folder / "calibration" / "camera_ECM.yaml"

    @property
    def base(self) -> Path:
        return self.bench.folder / "calibration" / "base_ECM.yaml"

    @cached_property
    def motion(self) -> Motion:
        return Motion(self.bench.chain, self.seed, self.seconds, True)

    def accept(self) -> list[Path]:
        calibration = self.bench.folder / "calibration"
        lenses = [load_lens(calibration / eye) for eye in (LEFT, RIGHT)]
        state = DriftState(MOVED, cause=self.cause)
        return accept(self.bench.cell, state, lenses, self._look, ORIGIN)

    def _look(self, watch: DriftWatch) -> None:
        rng = np.random.default_rng(self.seed)
        elsewhere = Moved(lens={0: np.array([40.0, -30.0]), 1: np.array([-30.0, 50.0])})
        for at in self.motion.t:
            now = elsewhere if rng.uniform() < self.outliers else self.moved
            look_without_pictures(watch, self.bench, self.motion, float(at), now, rng)

    def off(self, moved: Moved) -> tuple[float, float, float]:
        """How far a tip 80 mm before the eye goes wrong [mm], and a command in its axes [deg].

        The third is how far joints and picture then disagree, seen through the lenses [mm].
        """
        chain, cell = copy(self.bench.chain), surg_core.load_cell(self.bench.folder)
        chain.bench, chain.rng = copy(chain.bench), np.random.default_rng(7)
        X_VV = surg_core.make_pose(moved.camera[3:])
        X_VV[:3, :3] = Rotation.from_rotvec(moved.camera[:3]).as_matrix()
        chain.bench.X_FV = chain.bench.X_FV @ X_VV
        chain.X_W_ECM = stepped(chain.X_W_ECM, moved.base.get(SCOPE))
        # How the one base stands to the other is all that counts: a moved tool moves the scope.
        X_WT = np.array(chain.cell.arms[TOOL].X_WB_stated)
        chain.X_W_ECM = X_WT @ np.linalg.inv(stepped(X_WT, moved.base.get(TOOL))) @ chain.X_W_ECM
        q = np.array(cell.arms[SCOPE].robot.home)
        X_BF = np.asarray(chain.cell.arms[SCOPE].chain.forward(q))
        X_FV = load_camera(self.camera).X_FV
        assert X_FV is not None
        believed = cell.arms[SCOPE].X_WB @ X_BF @ X_FV
        E = np.linalg.inv(believed) @ chain.X_W_ECM @ X_BF @ chain.bench.X_FV
        shift = np.linalg.norm((E @ LOOKED_AT - LOOKED_AT)[:3], axis=0)
        turn = Rotation.from_matrix(E[:3, :3]).magnitude()
        seen = np.median([chain.disagreement(cell, X_FV) for _ in range(25)])
        return 1e3 * float(np.sqrt(np.mean(shift**2))), float(np.degrees(turn)), 1e3 * float(seen)


def stepped(X: np.ndarray, step: np.ndarray | None) -> np.ndarray:
    """A base (4, 4) after a step (6,) in the world's axes."""
    moved = X.copy()
    if step is not None:
        moved[:3, :3] = Rotation.from_rotvec(step[:3]).as_matrix() @ X[:3, :3]
        moved[:3, 3] += step[3:]
    return moved


def bump(seed: int, part: str = "camera") -> Moved:
    rng = np.random.default_rng(9000 + seed)
    step = np.r_[drawn(rng, np.radians(1.0), np.radians(10.0)), drawn(rng, 0.0015, 0.02)]
    if part == "camera":
        return Moved(camera=step)
    return Moved(
        base={part[-len(SCOPE) :] if SCOPE in part else TOOL: step / ([5.0] * 3 + [1.0] * 3)}
    )


PARTS = {"camera": 24, f"base of {SCOPE}": 20, f"base of {SCOPE} or base of {TOOL}": 20}


@pytest.mark.parametrize("cause", PARTS)
def test_an_accepted_bump_leaves_what_a_fresh_calibration_leaves(
    cause: str, tmp_path: Path, full: bool
) -> None:
    count, rows = PARTS[cause] if full else 1, []
    for seed in range(3, 3 + count):
        part = f"base of {TOOL}" if TOOL in cause else cause
        made = Recovery(tmp_path / str(seed), seed, bump(seed, part), cause)
        fresh, bumped = made.off(Moved()), made.off(made.moved)
        try:
            written = made.accept()
        except surg_core.ConfigError as why:
            print(seed, why)
            assert "Record" in str(why)
            continue
        rows.append([fresh, bumped, made.off(made.moved)])
        print(seed, np.round(rows[-1], 3).tolist())
        assert written[0] == (made.camera if cause == "camera" else made.base)
    columns = np.array(rows).transpose(1, 0, 2)
    names = ("fresh", "bumped", "after")
    said = [
        f"{name} {x[0]:.3f} mm, {x[1]:.3f}°, {x[2]:.3f} mm"
        for q in (50, 95)
        for name, x in zip(names, np.percentile(columns, q, axis=1), strict=True)
    ]
    print(f"{cause}: {len(rows)} of {count}: {'; '.join(said)}")
    fresh, bumped, after = np.median(columns, axis=1)
    if full:
        assert len(rows) >= 0.75 * count
        assert (after[1:] <= 1.2 * fresh[1:]).all()
    assert after[0] < 0.15 and after[1] < 0.15 and bumped[0] > 1.0


def poses(made: Recovery) -> tuple[np.ndarray, np.ndarray]:
    X_FV = load_camera(made.camera).X_FV
    assert X_FV is not None
    return X_FV, load_base(made.base).X_WB


def test_what_is_not_named_keeps_its_pose(tmp_path: Path) -> None:
    made = Recovery(tmp_path / "camera", 3, bump(3))
    (X_FV, X_WB), n = poses(made), load_base(made.base).evidence.n
    made.accept()
    after = poses(made)
    np.testing.assert_array_equal(after[1], X_WB)
    assert load_base(made.base).evidence.n == n and not np.allclose(after[0], X_FV, atol=1e-3)
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
