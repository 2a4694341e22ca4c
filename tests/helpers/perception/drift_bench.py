"""A calibrated two-arm cell, its true chain, and what its eyes see of a moving instrument.

The truth is computed here: own poses, the bench's own lenses, lines cut with lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from unittest.mock import patch

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import surg_core
from helpers.endoscope_files import copied_cell
from helpers.perception.drift_settings import Flaws
from helpers.recording.recording_synthetic import Synthetic, cycle, header
from helpers.recording.stereo_recording import EYES, FRAME_NS, camera_info, image
from helpers.sim.calibrated_chain import Chain
from surg_core.lens_file import load_lens
from surg_perception.calibration.result_files import LEFT, RIGHT
from surg_perception.calibration.tip_finder import NotSeen
from surg_perception.drift import drift_watch
from surg_perception.drift.shaft_finder import REACH, SLANTS, ShaftSeen
from surg_recording.episode.episode_recorder import Recording

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
TOOL, SCOPE = "PSM1", "ECM"
RATE = 20
"""Pictures a second."""
SCALE = 3
"""Pictures are drawn so many times as large, then averaged: edges to a tenth of a pixel."""
TRUE_RADIUS = 0.0025
"""[m] Of the drawn shaft: a capsule holds the jaw too, so it is thinner than stated."""


@dataclass
class Moved:
    """By how much the true chain differs from the one that was calibrated.

    Attributes:
        camera: (6,) rotation vector [rad] and shift [m] of the left eye, in its own axes.
        base: (6,) the same of each arm's base, in the world's axes.
        lens: (2,) of each eye's picture [px].
        tool: (6,) of the instrument about its tip, in the flange's axes.
        lag: Of the pictures [s].
    """

    camera: Array = field(default_factory=lambda: np.zeros(6))
    base: dict[str, Array] = field(default_factory=dict)
    lens: dict[int, Array] = field(default_factory=dict)
    tool: Array = field(default_factory=lambda: np.zeros(6))
    lag: float = 0.0


def _step(x: Array) -> Array:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = Rotation.from_rotvec(x[:3]).as_matrix(), x[3:]
    return X


class Motion:
    """Joints of both arms while a hand moves the tip before the eyes, and the scope or not.

    Args:
        chain: The true chain.
        seed: Of the motion.
        seconds: How long.
        scope: Whether the endoscope moves too.
        rate: Pictures a second.
    """

    def __init__(
        self, chain: Chain, seed: int, seconds: float, scope: bool, rate: float = RATE
    ) -> None:
        self.t = np.arange(int(seconds * rate)) / rate
        for size in (1.0, 0.7, 0.5, 0.3):
            try:
                self._q = self._joints(chain, np.random.default_rng(seed), scope, size)
            except RuntimeError:  # an arm does not reach that far
                continue
            return
        raise RuntimeError(f"motion {seed}: out of reach")

    def _joints(
        self, chain: Chain, rng: np.random.Generator, scope: bool, size: float
    ) -> dict[str, Array]:
        """(n, 6) of both arms; `size` scales the ways."""
        bench = chain.bench
        x, y, z = (self._smooth(rng, 0.25) for _ in range(3))
        p_V = np.column_stack([0.012 * size * x, 0.012 * size * y, 0.085 + 0.007 * size * z])
        scope_arm = bench.cell.arms[SCOPE]
        q_scope = np.tile(np.array(scope_arm.robot.home), (len(self.t), 1))
        if scope:
            ways = 0.01 * size * np.column_stack([self._smooth(rng, 0.08) for _ in range(3)])
            places = bench.scope.tip_home + ways - ways[0]
            q_scope = np.array([bench._touching(bench.scope, place) for place in places])
        X_TS = surg_core.inverse_pose(bench.tool.arm.X_WB_stated) @ chain.X_W_ECM
        X_TV = X_TS @ np.asarray(scope_arm.chain.forward_batch(q_scope)) @ bench.X_FV
        places = np.einsum("nij,nj->ni", X_TV[:, :3, :3], p_V) + X_TV[:, :3, 3]
        q_tool = np.array([bench._touching(bench.tool, place) for place in places])
        return {TOOL: q_tool, SCOPE: q_scope}

    def _smooth(self, rng: np.random.Generator, highest: float) -> Array:
        """Slow noise (n,) of unit variance, up to a frequency [Hz]."""
        f, phase = rng.uniform(0.3 * highest, highest, 12), rng.uniform(0.0, 2.0 * np.pi, 12)
        waves = np.sin(2.0 * np.pi * f[:, None] * self.t + phase[:, None])
        return np.asarray(waves.sum(axis=0) / np.sqrt(6.0))

    def joints(self, arm: str, at: float) -> Array | None:
        """(n,) [rad] at a time [s]."""
        if not -0.02 <= at <= self.t[-1] + 0.02:
            return None
        return np.array([np.interp(at, self.t, column) for column in self._q[arm].T])


class DriftBench:
    """A cell that was calibrated, with the small errors of that calibration.

    Args:
        folder: A new folder for the cell.
        seed: Of its unknown errors.
        residual: Of the calibration of its instrument [m].
    """

    def __init__(self, folder: Path, seed: int, residual: float = 0.0) -> None:
        self.chain = Chain(seed, surg_core.load_cell(copied_cell(folder)))
        self.folder = self.chain.cell.folder
        self.chain.write(self.folder / "calibration")
        tool = self.folder / "calibration" / f"tool_{TOOL}.yaml"
        tool.write_text(tool.read_text().replace("residual: 0.0", f"residual: {residual}"))
        self.cell = surg_core.load_cell(self.folder)
        self.rng = np.random.default_rng(seed)

    def shaft(self, motion: Motion, at: float, moved: Moved, up: Array) -> Array:
        """Points (n, 3) of the true axis before the left eye, so far up from the tip (n,) [m]."""
        chain, cell = self.chain, self.chain.cell
        q, q_scope = (motion.joints(arm, max(0.0, at - moved.lag)) for arm in (TOOL, SCOPE))
        bases = {TOOL: cell.arms[TOOL].X_WB_stated, SCOPE: chain.X_W_ECM}
        for arm, x in moved.base.items():
            turned = _step(np.r_[x[:3], np.zeros(3)])[:3, :3] @ bases[arm][:3, :3]
            bases[arm] = surg_core.make_pose(bases[arm][:3, 3] + x[3:])
            bases[arm][:3, :3] = turned
        tool = chain.bench.tool.arm
        X_WF = bases[TOOL] @ np.asarray(tool.chain.forward(q))
        X_WV = bases[SCOPE] @ np.asarray(cell.arms[SCOPE].chain.forward(q_scope))
        X_VW = np.linalg.inv(X_WV @ chain.bench.X_FV @ _step(moved.camera))
        s_F = Rotation.from_rotvec(moved.tool[:3]).apply(np.asarray(tool.tool.s_F))
        p_F = np.asarray(tool.tool.p_FTip) + moved.tool[3:] - up[:, None] * s_F
        p_W = p_F @ X_WF[:3, :3].T + X_WF[:3, 3]
        return np.asarray(p_W @ X_VW[:3, :3].T + X_VW[:3, 3])

    def pixels(self, p_V: Array, eye: int, moved: Moved) -> Array:
        """(n, 2) of points before the left eye, in one eye's picture."""
        bench = self.chain.bench
        p = p_V if eye == 0 else bench._right(p_V)
        return np.asarray(bench.eyes[eye].project(p) + moved.lens.get(eye, np.zeros(2)))

    def pair(self, motion: Motion, at: float, moved: Moved) -> tuple[Picture, Picture]:
        """Drawn pictures (480, 640, 3): a dark bar before a textured wall in a round picture."""
        p_V = self.shaft(motion, at, moved, np.linspace(0.012, 0.16, 60))
        left, right = (self._draw(p_V, eye, moved) for eye in (0, 1))
        return left, right

    def _draw(self, p_V: Array, eye: int, moved: Moved) -> Picture:
        width, height = self.chain.bench.size
        wall = self._wall.copy()
        p_V = p_V[p_V[:, 2] > 0.03]
        axis = self.pixels(p_V, eye, moved)
        near = (np.abs(axis) < 4 * width).all(axis=1)
        p_V, axis = p_V[near], axis[near]
        if len(axis) > 2:
            along = np.gradient(axis, axis=0)
            along /= np.linalg.norm(along, axis=1, keepdims=True)
            across = np.column_stack([-along[:, 1], along[:, 0]])
            half = (TRUE_RADIUS * self.focal / p_V[:, 2])[:, None]
            rim = np.concatenate([axis + half * across, (axis - half * across)[::-1]])
            corners = np.round(((rim + 0.5) * SCALE - 0.5) * 16).astype(np.int32)
            cv2.fillPoly(wall, [corners], (38, 36, 35), cv2.LINE_AA, shift=4)
        small = cv2.resize(wall, (width, height), interpolation=cv2.INTER_AREA)
        y, x = np.mgrid[:height, :width]
        small[np.hypot(x - width / 2, y - height / 2) > 0.55 * height] = 0
        noisy = small + self.rng.normal(scale=2.0, size=small.shape)
        return np.asarray(np.clip(np.round(noisy), 0, 255), dtype=np.uint8)

    @property
    def focal(self) -> float:
        """[px] Of the left eye, in its middle."""
        ends = self.chain.bench.eyes[0].project(np.array([[-0.001, 0, 1.0], [0.001, 0, 1.0]]))
        return float(ends[1, 0] - ends[0, 0]) / 0.002

    @cached_property
    def _wall(self) -> Picture:
        width, height = self.chain.bench.size
        rng = np.random.default_rng(5)
        rough = cv2.GaussianBlur(rng.uniform(90, 190, (60, 80, 3)), (0, 0), 1.2)
        size = width * SCALE, height * SCALE
        return cv2.resize(np.asarray(rough, dtype=np.uint8), size, interpolation=cv2.INTER_CUBIC)

    def record(self, folder: Path, motion: Motion, moved: Moved) -> Path:
        """An episode of drawn pictures and of the joints of both arms."""
        eyes = [load_lens(self.folder / "calibration" / name) for name in (LEFT, RIGHT)]
        recording = Recording(
            folder,
            mode="lockstep",
            arms=[TOOL, SCOPE],
            cameras=list(EYES),
            manifest={"run": {}, "versions": {"surg_recording": "test"}},
            min_free_bytes=0,
            video_quality="18",
        )
        for number, at in enumerate(motion.t, start=1):
            stamp = number * FRAME_NS
            for arm in (TOOL, SCOPE):
                q = motion.joints(arm, float(at))
                message = cycle(Synthetic(), 25 * number, 1)
                message.header, message.q = header(stamp), q.tolist()
                recording.cycle(arm, message, stamp)
            for eye, picture in zip(EYES, self.pair(motion, float(at), moved), strict=True):
                recording.image(eye, image(stamp, picture), stamp)
        models = {eye: camera_info(lens) for eye, lens in zip(EYES, eyes, strict=True)}
        return recording.close({"camera_info": models})


def look_without_pictures(
    watch: drift_watch.DriftWatch,
    bench: DriftBench,
    motion: Motion,
    at: float,
    moved: Moved,
    rng: np.random.Generator,
    flaws: Flaws | None = None,
    shown: Motion | None = None,
) -> bool:
    """The watch looks, and finds the shaft where it truly is, with noise in place of pictures.

    With the flaws of a setting, `moved.tool` already holds those of the instrument. `shown` moves
    what is seen in place of the joints.
    """
    up = np.linspace(0.005, 0.1, 40)
    eyes = iter((0, 1))
    true_V = bench.shaft(shown or motion, at, moved, up)

    def find(grey: Array, lit: Array, axis: Array, half: Array) -> ShaftSeen:
        eye = next(eyes)
        width, height = bench.chain.bench.size
        away = np.hypot(axis[:, 0] - width / 2, axis[:, 1] - height / 2)
        inside = np.flatnonzero(np.isfinite(axis).all(axis=1) & (away < 0.5 * height))
        if len(inside) < 8:
            raise NotSeen("outside")
        if flaws and flaws.hidden(at, eye):
            raise NotSeen("no shaft stands out from what is behind it")
        places = [int(inside[len(inside) // 5]), int(inside[-1 - len(inside) // 5])]
        normals, ways = beside(axis, bench.pixels(true_V, eye, moved), places)
        slant = (ways[1] - ways[0]) / np.linalg.norm(axis[places[1]] - axis[places[0]])
        if not (np.abs(ways.mean()) < REACH and abs(slant) < SLANTS[-1]):
            raise NotSeen("far away")
        if flaws:
            seen = axis[places] + ways[:, None] * normals
            ways = ways + flaws.offsets(at, eye, list(seen))
        else:
            ways = ways + rng.normal(scale=0.15, size=2) + rng.normal(scale=0.25)
        return ShaftSeen(np.array(places, dtype=float), normals, ways, 0.07 if flaws else 0.15, 0.8)

    grey = rng.integers(0, 255, (48, 64, 3)).astype(np.uint8)  # never twice the same
    with patch.object(drift_watch, "find_shaft", find):
        return watch.look(at, (grey, grey), motion.joints)


def beside(axis: Array, true: Array, places: Sequence[int]) -> tuple[Array, Array]:
    """Where the true curve (m, 2) cuts the normals of another one (n, 2) at some of its points.

    Returns:
        The normals (k, 2), and the way along each [px].
    """
    along = np.gradient(axis, axis=0)
    normals = np.column_stack([-along[:, 1], along[:, 0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ways = []
    for place in places:
        nearest = int(np.argmin(np.linalg.norm(true - axis[place], axis=1)))
        d = np.gradient(true, axis=0)[nearest]
        to = true[nearest] - axis[place]
        n = normals[place]
        ways.append((to[0] * d[1] - to[1] * d[0]) / (n[0] * d[1] - n[1] * d[0]))
    return normals[list(places)], np.array(ways)
