"""A board before the simulated endoscope: pictures, joints and what the true poses were.

The bench traces the rays of a real lens (``EndoscopeLens``) onto a flat pattern. It shares no code
with what solves the calibration, so that a test of one by the other means something. It writes the
folder of views that ``./surg calibrate CELL ... --from FOLDER`` reads: ``<view>_left.png``,
``<view>_right.png`` and ``views.csv`` with the joints of each arm. ::

    python3 tests/helpers/sim/board_bench.py CELL board.png FOLDER --step handeye
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

import surg_core
from surg_core import axis_angle_to_matrix
from surg_core.transforms import minimal_rotation
from surg_sim.appearance.lens import EndoscopeLens, TrueEye
from surg_sim.arrays import Array, Picture
from surg_sim.physics.calibration_bench import Bench, across
from surg_sim.physics.endoscope_rig import camera_poses, holder
from surg_sim.physics.patient_settings import find_setting
from surg_sim.physics.pose_error import with_base_error

SAMPLES = 3
"""Rays across and down in each pixel."""
BLUR = 0.5
"""[px] Blur of the optics, one sigma; assumed."""
NOISE = 2.0
"""[grey levels] Noise of the sensor, one sigma; assumed."""
PAPER = 0.006
"""[m] White margin around the pattern."""
DISTANCES = (0.055, 0.105)
"""[m] From the lens to the middle of the board."""
TILT = 0.6
"""[rad] Largest tilt of the board against the picture."""

_PLACES = (
    (0.080, (0.25, -0.15, 0.1), (0.0, 0.0)),
    (0.110, (-0.3, 0.1, 0.0), (0.3, 0.2)),
    (0.060, (0.1, 0.3, 0.2), (-0.1, 0.08)),
    (0.105, (0.2, 0.2, -0.3), (-0.3, -0.2)),
    (0.060, (-0.2, 0.2, -0.1), (0.1, -0.08)),
    (0.110, (0.2, -0.2, 0.1), (-0.3, 0.2)),
    (0.065, (0.2, -0.2, 0.1), (0.0, 0.1)),
    (0.110, (0.2, -0.2, 0.1), (0.3, -0.2)),
)
"""Distance [m], turn [rad] and offset (share of the distance) of a board that is touched."""


@dataclass(frozen=True)
class Pattern:
    """A printed pattern: its picture (h, w), grey, and its width and height [m]."""

    picture: Picture
    size: tuple[float, float]


class BoardPainter:
    """Draws a pattern as an eye sees it."""

    def __init__(self, pattern: Pattern, eye: TrueEye) -> None:
        self._pattern, self._eye = pattern, eye
        rays = eye.rays()
        # Rays are smooth: between pixels, linear interpolation is exact to 1e-6 px.
        fine = (SAMPLES * eye.width, SAMPLES * eye.height)
        self._rays = cv2.resize(rays, fine, interpolation=cv2.INTER_LINEAR).astype(np.float32)
        self._light = eye.light()

    def draw(self, X_CBoard: Array, rng: np.random.Generator) -> Picture:
        """Picture (h, w) of a board at X_CBoard, its frame x right, y up, z out, lower left."""
        (wide, high), texture = self._pattern.size, self._pattern.picture
        rows, columns = texture.shape
        # A ray meets the board at p_C = depth * ray; p_Board = R^T (p_C - o).
        R, o = X_CBoard[:3, :3].astype(np.float32), X_CBoard[:3, 3].astype(np.float32)
        x, y = self._rays[..., 0], self._rays[..., 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (R[:, 2] @ o) / (x * R[0, 2] + y * R[1, 2] + R[2, 2])
            u = depth * (x * R[0, 0] + y * R[1, 0] + R[2, 0]) - R[:, 0] @ o
            v = depth * (x * R[0, 1] + y * R[1, 1] + R[2, 1]) - R[:, 1] @ o
        seen = cv2.remap(
            texture.astype(np.float32),
            u * np.float32(columns / wide) - np.float32(0.5),
            np.float32(rows - 0.5) - v * np.float32(rows / high),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=235.0,
        )
        paper = (np.abs(u - wide / 2) < wide / 2 + PAPER) & (
            np.abs(v - high / 2) < high / 2 + PAPER
        )
        seen[~(paper & (depth > 0))] = 60.0
        eye = self._eye
        grey = cv2.resize(seen, (eye.width, eye.height), interpolation=cv2.INTER_AREA)
        grey = (20.0 + 0.8 * cv2.GaussianBlur(grey, (0, 0), BLUR)) * self._light
        noisy = grey + rng.normal(scale=NOISE, size=grey.shape)
        return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class BenchView:
    """One rest before the board.

    Attributes:
        joints: Joint positions (n,) of each arm as its encoders state them [rad].
        X_VBoard: True pose (4, 4) of the board before the left eye.
        touch: Number of the corner that an instrument touches; None: it touches nothing.
    """

    joints: dict[str, Array]
    X_VBoard: Array
    touch: int | None = None


class BoardBench:
    """The endoscope of a cell before a board.

    Args:
        cell: With an arm that holds an endoscope of two eyes.
        pattern: What is printed on the board.
        size: Width and height of the pictures [px].
        seed: Of poses, hands and noise.
        lenses: The true lenses, left and right.
        X_FV: True pose (4, 4) of the left eye in the flange; None: the URDF's.
        X_LR: True pose (4, 4) of the right eye in the left one; None: the URDF's.
        X_WB: True bases (4, 4) by arm where they differ from the cell's.
        encoder: Noise of the joints, one sigma [rad].
        hand: Distance of a touching tip from its corner, one sigma for each axis [m].

    Raises:
        ValueError: No arm of the cell holds an endoscope.
    """

    def __init__(
        self,
        cell: surg_core.Cell,
        pattern: Pattern,
        size: tuple[int, int] = (640, 480),
        seed: int = 0,
        lenses: tuple[EndoscopeLens, EndoscopeLens] = (EndoscopeLens(), EndoscopeLens()),
        *,
        X_FV: Array | None = None,
        X_LR: Array | None = None,
        X_WB: Mapping[str, Array] | None = None,
        encoder: float = 2e-5,
        hand: float = 1e-4,
    ) -> None:
        self.cell, self.pattern, self.size, self.lenses = cell, pattern, size, lenses
        self.encoder, self.hand = encoder, hand
        self.rng = np.random.default_rng(seed)
        scope = holder(list(cell.arms.values()))
        if scope is None or scope.instrument.camera is None:
            raise ValueError(f"{cell.folder}: no arm holds an endoscope")
        self.scope = Bench(cell, seed, scope.name)
        others = [name for name in cell.arms if name != scope.name]
        self.tool = Bench(cell, seed, others[0] if others else scope.name)
        left, right = camera_poses(scope)
        self.X_FV = left if X_FV is None else X_FV
        self.X_LR = surg_core.inverse_pose(left) @ right if X_LR is None else X_LR
        self.X_WB = {name: arm.X_WB_stated for name, arm in cell.arms.items()} | dict(X_WB or {})
        fovy = float(scope.instrument.camera.fovy)
        self.eyes = tuple(TrueEye.of(fovy, *size, lens) for lens in lenses)
        self._painters: list[BoardPainter] = []
        # The board of hand-eye and touch lies still, 80 mm before the scope at home.
        X_BV = self.scope.X_home @ self.X_FV
        self.X_BBoard = X_BV @ self._facing(0.080, np.array([0.25, -0.15, 0.1]))

    def _facing(self, distance: float, turn: Array, beside: Array | None = None) -> Array:
        """Pose (4, 4) of a board that looks at the eye, turned by a rotation vector (3,)."""
        wide, high = self.pattern.size
        R = np.diag([1.0, -1.0, -1.0])
        if np.any(turn):
            R = axis_angle_to_matrix(turn, float(np.linalg.norm(turn))) @ R
        X = surg_core.make_pose(-R @ [wide / 2, high / 2, 0.0] + [0.0, 0.0, distance], R)
        if beside is not None:
            X[:2, 3] += beside * distance
        return X

    def held_board(self, count: int) -> Iterator[BenchView]:
        """A person moves the board before the scope, which is at rest."""
        joints = {name: np.array(arm.robot.home) for name, arm in self.cell.arms.items()}
        for number in range(count):
            # The middle of the board goes round the picture, far out and near its middle.
            angle, out = np.pi * (0.25 + 0.5 * number), 0.5 if number % 8 < 4 else 0.2
            beside = out * np.array([np.cos(angle), 0.75 * np.sin(angle)])
            turn = np.append(across(np.eye(3)[2], self.rng)[:2], 0.0)
            turn *= self.rng.uniform(0.15, TILT)
            turn[2] = self.rng.uniform(-0.4, 0.4)
            distance = self.rng.uniform(*DISTANCES)
            yield BenchView(joints, self._facing(distance, turn, beside))

    def moved_scope(self, count: int) -> Iterator[BenchView]:
        """The scope goes round the still board, through its trocar."""
        found = 0
        for _ in range(60 * count):
            X_BF = self._through_trocar()
            X_VBoard = surg_core.inverse_pose(X_BF @ self.X_FV) @ self.X_BBoard
            if found < count and self._sees(X_VBoard):
                q = self.scope._inverse(X_BF)
                if q is not None:
                    found += 1
                    yield BenchView(self._measured({self.scope.arm.name: q}), X_VBoard)
        if found < count:
            raise RuntimeError(f"only {found} of {count} poses see the board and are within reach")

    def touches(self, corners: Array, numbers: Sequence[int]) -> Iterator[BenchView]:
        """Another arm's tip touches corners of the board; the scope stands at home.

        A person moves the board after every fourth touch.

        Args:
            corners: (n, 3) all corners in the board frame [m].
            numbers: Of the corners that are touched.
        """
        tool, name = self.tool, self.scope.arm.name
        X_WV = self.X_WB[name] @ self.scope.X_home @ self.X_FV
        X_TV = surg_core.inverse_pose(self.X_WB[tool.arm.name]) @ X_WV
        for count, number in enumerate(numbers):
            distance, turn, beside = _PLACES[count // 4 % len(_PLACES)]
            X_VBoard = self._facing(distance, np.array(turn), np.array(beside))
            place = (X_TV @ X_VBoard @ np.append(corners[number], 1.0))[:3]
            place = place + self.rng.normal(scale=self.hand, size=3)
            joints = {tool.arm.name: self._touching(tool, place), name: self.scope.home}
            yield BenchView(self._measured(joints), X_VBoard, number)

    def _touching(self, tool: Bench, place: Array) -> Array:
        """Joints (n,) with the tip at a place (3,) of the tool's base, through its trocar."""
        s = place - tool.arm.trocar.p_BRcm
        s = s / np.linalg.norm(s)
        R = minimal_rotation(tool.s_home, s) @ tool.X_home[:3, :3]
        q = tool._inverse(surg_core.make_pose(place - R @ tool.p_FTip, R))
        if q is None:
            raise RuntimeError(f"the instrument cannot reach {np.round(place, 3).tolist()}")
        return q

    def _through_trocar(self) -> Array:
        """A random flange pose (4, 4) of the scope with its shaft through the trocar."""
        scope, rng = self.scope, self.rng
        tilt = axis_angle_to_matrix(across(scope.s_home, rng), rng.uniform(0.05, 0.45))
        R = tilt @ axis_angle_to_matrix(scope.s_home, rng.uniform(-0.9, 0.9)) @ scope.X_home[:3, :3]
        depth = float((scope.tip_home - scope.arm.trocar.p_BRcm) @ scope.s_home)
        tip = scope.arm.trocar.p_BRcm + (depth + rng.uniform(-0.025, 0.025)) * (R @ scope.s_F)
        return surg_core.make_pose(tip - R @ scope.p_FTip, R)

    def _sees(self, X_VBoard: Array) -> bool:
        """Whether both eyes see the middle of the board and its face."""
        wide, high = self.pattern.size
        middle = (X_VBoard @ [wide / 2, high / 2, 0.0, 1.0])[None, :3]
        if middle[0, 2] < 0.04 or X_VBoard[2, 2] > -0.6:
            return False
        for eye, p in zip(self.eyes, (middle, self._right(middle)), strict=True):
            pixel = eye.project(p)[0]
            edge = 0.2 * eye.height
            if not (np.all(pixel > edge) and np.all(pixel < np.array(self.size) - edge)):
                return False
        return True

    def _right(self, p_L: Array) -> Array:
        """Points (n, 3) of the left eye's frame in the right one's."""
        return np.asarray((p_L - self.X_LR[:3, 3]) @ self.X_LR[:3, :3])

    def _measured(self, joints: dict[str, Array]) -> dict[str, Array]:
        """What the encoders state."""
        return {n: q + self.rng.normal(scale=self.encoder, size=q.shape) for n, q in joints.items()}

    def pixels(self, view: BenchView, p_Board: Array) -> tuple[Array, Array]:
        """True pixels (n, 2) of points (n, 3) of the board in the left and in the right picture."""
        p_L = p_Board @ view.X_VBoard[:3, :3].T + view.X_VBoard[:3, 3]
        return self.eyes[0].project(p_L), self.eyes[1].project(self._right(p_L))

    def pictures(self, view: BenchView) -> tuple[Picture, Picture]:
        """What the left and the right eye see, (h, w), grey."""
        if not self._painters:
            self._painters = [BoardPainter(self.pattern, eye) for eye in self.eyes]
        left, right = self._painters
        X_RBoard = surg_core.inverse_pose(self.X_LR) @ view.X_VBoard
        return left.draw(view.X_VBoard, self.rng), right.draw(X_RBoard, self.rng)

    def write(self, folder: Path, views: list[BenchView]) -> None:
        """Write the folder of views."""
        folder.mkdir(parents=True, exist_ok=True)
        arms = {name: self.cell.arms[name].robot.joint_names for name in views[0].joints}
        header = [f"{name}/{joint}" for name, joints in arms.items() for joint in joints]
        with (folder / "views.csv").open("w", encoding="utf-8", newline="") as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(["view", "stamp", "touch", *header])
            for number, view in enumerate(views):
                name = f"{number:03d}"
                for eye, picture in zip(("left", "right"), self.pictures(view), strict=True):
                    cv2.imwrite(str(folder / f"{name}_{eye}.png"), picture)
                touch = "" if view.touch is None else view.touch
                joints = [f"{q:.9f}" for arm in arms for q in view.joints[arm]]
                rows.writerow([name, f"{float(number):.9f}", touch, *joints])


def inner_corners(columns: int, rows: int, square: float) -> Array:
    """Corners (n, 3) of a board, row by row from the upper left [m]."""
    row, column = np.divmod(np.arange((columns - 1) * (rows - 1)), columns - 1)
    places = [square * (column + 1), square * (rows - 1 - row), np.zeros(len(row))]
    return np.asarray(np.column_stack(places))


def of_setting(cell: Path, pattern: Pattern, setting: str, seed: int) -> BoardBench:
    """The bench with the errors of base, camera and lens that a setting has."""
    loaded, true = surg_core.load_cell(cell), find_setting(setting)
    scope = holder(list(loaded.arms.values()))
    if scope is None:
        raise ValueError(f"{cell}: no arm holds an endoscope")
    built = with_base_error(loaded, true.base_error)
    X_FV = camera_poses(scope)[0]
    if true.camera_error is not None:
        X_FV = X_FV @ true.camera_error.motion()
    bases = {name: np.array(arm.X_WB_stated) for name, arm in built.arms.items()}
    lenses = (true.lens, true.lens)
    return BoardBench(loaded, pattern, seed=seed, lenses=lenses, X_FV=X_FV, X_WB=bases)


def main(words: Sequence[str] | None = None) -> int:
    """Record views of a board of 11x8 squares before the simulated endoscope of a cell."""
    parser = argparse.ArgumentParser(prog="board_bench.py", description=main.__doc__)
    parser.add_argument("cell", type=Path)
    parser.add_argument("board", type=Path, help="./surg calibrate CELL board --out board.png")
    parser.add_argument("folder", type=Path, help="for ./surg calibrate CELL ... --from FOLDER")
    parser.add_argument("--step", choices=("stereo", "handeye", "touch"), default="stereo")
    parser.add_argument("--square", type=float, default=5.0, help="[mm]")
    parser.add_argument("--setting", default="phantom", help="such as phantom+unregistered+lens")
    options = parser.parse_args(words)
    columns, rows = 11, 8
    picture = cv2.imread(str(options.board), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        parser.error(f"{options.board}: is not a picture")
    square = 1e-3 * options.square
    pattern = Pattern(np.asarray(picture, np.uint8), (columns * square, rows * square))
    bench = of_setting(options.cell, pattern, options.setting, seed=0)
    corners = inner_corners(columns, rows, square)
    ends = [0, columns - 2, len(corners) - columns + 1, len(corners) - 1]
    views = {
        "stereo": lambda: bench.held_board(20),
        "handeye": lambda: bench.moved_scope(20),
        "touch": lambda: bench.touches(corners, ends * 8),
    }[options.step]
    bench.write(options.folder, list(views()))
    print(f"{options.folder}: views for {options.step}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
