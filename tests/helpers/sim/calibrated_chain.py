"""A cell with errors that nobody knows, and its calibration from corners without pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import surg_core
from helpers.sim.board_bench import BenchView, BoardBench
from helpers.sim.board_views import BARREL, BOARD, Array, bench, corners, moved_camera
from surg_core.base_file import write_base
from surg_perception.calibration import evidence
from surg_perception.calibration.base_steps import base_in_world
from surg_perception.calibration.bases import SeenBase, solve_base
from surg_perception.calibration.chain import DISTANCE
from surg_perception.calibration.handeye import HandEyeFit, pair_pose, solve_handeye
from surg_perception.calibration.result_files import Origin, read_stereo, save_handeye, save_stereo
from surg_perception.calibration.small_motions import moved, transform
from surg_perception.calibration.stereo import StereoFit, solve_stereo

NOISE = 0.05
"""[px] Noise of a corner: what rendered boards have."""
TOUCHED = [0, 9, 60, 69] * 8
ORIGIN = Origin("synthetic", "2026-11-23", "simulated")


@dataclass
class Chain:
    """The unknown truth of one seed: camera up to 10 mm, 5 deg off, base up to 15 mm, 3 deg."""

    seed: int
    cell: surg_core.Cell

    def __post_init__(self) -> None:
        """Draw the errors."""
        self.rng = np.random.default_rng(1000 + self.seed)
        w, d = self.rng.normal(size=(2, 3))
        step = np.concatenate(
            [
                np.radians(3.0) * self.rng.uniform() * w / np.linalg.norm(w),
                0.015 * self.rng.uniform() * d / np.linalg.norm(d),
            ]
        )
        self.X_W_ECM = moved(np.array(self.cell.arms["ECM"].X_WB_stated), step)
        self.bench: BoardBench = bench(
            self.seed,
            BARREL,
            cell=self.cell,
            pixels=8,
            X_FV=moved_camera(self.rng),
            X_WB={"ECM": self.X_W_ECM},
        )

    def seen(self, views: list[BenchView]) -> list:
        """Corners of each view."""
        return [corners(self.bench, view, NOISE, self.rng) for view in views]

    def stereo(self, count: int = 20) -> StereoFit:
        """Both lenses."""
        views = list(self.bench.held_board(count))
        return solve_stereo(self.seen(views), self.bench.size, "plumb_bob")

    def handeye(self, stereo: StereoFit, count: int = 15) -> HandEyeFit:
        """The eye in the flange, through the trocar."""
        views = list(self.bench.moved_scope(count))
        chain = self.cell.arms["ECM"].chain
        X_BF = np.array([chain.forward(view.joints["ECM"]) for view in views])
        return solve_handeye(stereo.stereo, X_BF, self.seen(views), stereo.fit.covariance)

    def base(self, stereo: StereoFit, handeye: HandEyeFit) -> tuple[HandEyeFit, SeenBase, int]:
        """Hand-eye and base as a person measures them who does what a refusal asks for.

        Returns:
            The hand-eye pose, the base, and how often it was refused.
        """
        for refused in range(3):
            touch = self.touch(stereo, handeye, TOUCHED * (1 + refused))
            try:
                evidence.check_touch(touch)
                return handeye, touch, refused
            except evidence.Refused:
                if touch.camera_share > 0.5:
                    handeye = self.handeye(stereo, 30)
        raise AssertionError(f"seed {self.seed}: three refusals, {touch.error}")

    def touch(
        self, stereo: StereoFit, handeye: HandEyeFit, numbers: Sequence[int] = TOUCHED
    ) -> SeenBase:
        """The base of PSM1 in that of ECM, by touches of these corners."""
        views = list(self.bench.touches(BOARD.corners, numbers))
        X_SF = np.array([self.cell.arms["ECM"].chain.forward(v.joints["ECM"]) for v in views])
        p_S = [
            transform(X @ handeye.X_FV @ pair_pose(stereo.stereo, pair), BOARD.corners[k][None])[0]
            for X, pair, k in zip(X_SF, self.seen(views), numbers, strict=True)
        ]
        p_T = np.array([self.tip(v.joints["PSM1"]) for v in views])
        return solve_base(np.array(p_S), p_T, X_SF, handeye.X_FV, handeye.of_views)

    def tip(self, q: Array) -> Array:
        """The tip by the joints of PSM1, in its base (3,) [m]."""
        arm = self.cell.arms["PSM1"]
        X = arm.chain.forward(q)
        return np.asarray(X[:3, :3] @ arm.tool.p_FTip + X[:3, 3])

    def write(self, folder: Path) -> None:
        """Calibrate everything, check the evidence, write the files of the cell."""
        stereo = self.stereo()
        evidence.check_stereo(stereo, self.bench.size)
        save_stereo(folder, stereo, BOARD, "", ORIGIN)
        handeye = self.handeye(stereo)
        handeye, touch, _ = self.base(stereo, handeye)
        evidence.check_handeye(handeye)
        camera = save_handeye(folder, "ECM", handeye, ORIGIN)
        arm, base = base_in_world(self.cell, touch, "touch", ORIGIN, camera)
        write_base(folder / f"base_{arm.name}.yaml", base, "synthetic")

    def disagreement(self, believed: surg_core.Cell, X_FV: Array) -> float:
        """Between the tip by joints and by picture, 80 mm before the scope at home [m]."""
        scope, tool = believed.arms["ECM"], believed.arms["PSM1"]
        home = np.array(scope.robot.home)
        p_V = np.append(self.rng.uniform(-0.015, 0.015, 2), DISTANCE)
        # True place of the tip, and the joints that bring it there.
        X_SV = scope.chain.forward(home) @ self.bench.X_FV
        X_TV = surg_core.inverse_pose(tool.X_WB_stated) @ self.X_W_ECM @ X_SV
        q = self.bench._touching(self.bench.tool, transform(X_TV, p_V[None])[0])
        left = self.bench.eyes[0].project(p_V[None])
        right = self.bench.eyes[1].project(self.bench._right(p_V[None]))
        noise = self.rng.normal(scale=NOISE, size=(2, 1, 2))
        eyes, _ = read_stereo(believed.folder / "calibration")
        by_picture = eyes.triangulate(left + noise[0], right + noise[1])[0]
        X_WV = scope.X_WB @ scope.chain.forward(home) @ X_FV
        by_joints = transform(surg_core.inverse_pose(X_WV) @ tool.X_WB, self.tip(q)[None])[0]
        return float(np.linalg.norm(by_picture - by_joints))
