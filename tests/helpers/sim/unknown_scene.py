"""The simulated cell with errors of base, camera and lens that only it knows, and its pictures."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

import surg_core
from helpers.sim.board_views import Array, bench
from helpers.sim.calibrated_chain import Chain
from surg_sim.appearance.endoscope_renderer import EndoscopeRenderer
from surg_sim.appearance.opengl import NoOpenGL
from surg_sim.physics.endoscope_projection import EndoscopeView
from surg_sim.physics.patient_settings import PatientSetting
from surg_sim.physics.world import World

SIZE = (640, 480)


class UnknownScene:
    """A cell as it is built, and as it believes itself to be.

    Args:
        cell: As it is believed.
        setting: The errors.
        seed: Of the calibration that `chain` writes.
    """

    def __init__(self, cell: surg_core.Cell, setting: PatientSetting, seed: int = 7) -> None:
        self.cell, self.world = cell, World(cell, visuals=True, setting=setting)
        try:
            self.renderer = EndoscopeRenderer(self.world, ("left", "right"), *SIZE)
        except NoOpenGL as error:
            pytest.skip(str(error))
        self.qpos = np.array(self.world.data.qpos)
        self.home = np.array(cell.arms["ECM"].robot.home)
        true = self.world.cell.arms["ECM"]
        X_WF = true.X_WB_stated @ true.chain.forward(self.home)
        X_WV = EndoscopeView(self.world.model, self.world.data).pose
        self.chain = Chain(seed, cell)
        self.chain.X_W_ECM = np.array(true.X_WB_stated)
        self.chain.bench = bench(
            seed,
            setting.lens,
            cell=cell,
            pixels=8,
            X_FV=surg_core.inverse_pose(X_WF) @ X_WV,
            X_WB={"ECM": self.chain.X_W_ECM},
        )

    def pictures(self, shift_W: Array) -> dict[str, np.ndarray]:
        """With the tip moved from home by (3,) in the world [m]."""
        tool = self.chain.bench.tool
        R_WB = np.asarray(tool.arm.X_WB_stated)[:3, :3]
        q = self.chain.bench._touching(tool, tool.tip_home + R_WB.T @ shift_W)
        for joint, angle in zip(tool.arm.robot.joint_names, q, strict=True):
            self.qpos[self.world.model.joint(f"{tool.arm.name}_robot_{joint}").qposadr[0]] = angle
        return self.renderer.render(self.qpos)

    def write_rests(self, folder: Path, count: int, rng: np.random.Generator) -> None:
        """A folder of views: the tip rests at random places before the still endoscope."""
        tool, scope = self.chain.bench.tool, self.chain.bench.scope
        X_SV = scope.X_home @ self.chain.bench.X_FV
        X_TS = surg_core.inverse_pose(tool.arm.X_WB_stated) @ self.chain.X_W_ECM
        R_WT, home = np.asarray(tool.arm.X_WB_stated)[:3, :3], tool.tip_home
        folder.mkdir()
        names = {a.name: a.robot.joint_names for a in (tool.arm, scope.arm)}
        header = [f"{arm}/{joint}" for arm, joints in names.items() for joint in joints]
        with (folder / "views.csv").open("w", encoding="utf-8", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["view", "stamp", *header])
            for number in range(count):
                p_V = np.append(rng.uniform(-0.018, 0.018, 2), rng.uniform(0.065, 0.1))
                place = (X_TS @ X_SV @ np.append(p_V, 1.0))[:3]
                for eye, picture in self.pictures(R_WT @ (place - home)).items():
                    noisy = picture + rng.normal(scale=2.0, size=picture.shape)
                    noisy = np.clip(np.round(noisy), 0, 255).astype(np.uint8)
                    cv2.imwrite(str(folder / f"{number:03d}_{eye}.png"), noisy[:, :, ::-1])
                q = self.chain.bench._touching(tool, place)
                joints = np.concatenate([q, self.home]) + rng.normal(scale=2e-5, size=len(header))
                rows.writerow([f"{number:03d}", number, *(f"{value:.9f}" for value in joints)])
