"""Ground truth of one arm: what the simulator knows and no controller may read."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

import surg_core
from surg_sim.arrays import Array
from surg_sim.physics.tool_drive import WRIST_JOINTS
from surg_sim.physics.trocar import Trocar


class ArmTruth(NamedTuple):
    """One arm at one tick; every vector in the arm's base frame, (3,), SI."""

    shaft_point: Array  # a point of the shaft axis: the tip, or the wrist's pitch axis [m]
    shaft_axis: Array  # unit vector, flange to tip
    tip: Array  # tip [m]
    tip_velocity: Array  # [m/s]
    trocar: Array  # undisturbed trocar point [m]
    trocar_loaded: Array  # the wall's hole under load [m]
    trocar_force: Array  # force of the shaft on the wall [N]
    jaw: float  # opening angle [rad]

    @property
    def deviation(self) -> float:
        """Distance of the undisturbed trocar point to the shaft axis [m]."""
        d = self.trocar - self.shaft_point
        return float(np.linalg.norm(d - (d @ self.shaft_axis) * self.shaft_axis))

    @property
    def displacement(self) -> Array:
        """Loaded minus undisturbed trocar point [m], (3,)."""
        return self.trocar_loaded - self.trocar


class TruthReader:
    """Reads the truth of one arm out of a scene whose kinematics are up to date."""

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, arm: surg_core.Arm, trocar: Trocar
    ) -> None:
        self._model, self._data, self._trocar = model, data, trocar
        self._tip = model.body(f"{arm.name}_{arm.instrument.tip_link}").id
        self._R_BW = np.array(arm.X_WB_stated[:3, :3].T, dtype=np.float64)
        self._p_WB = np.array(arm.X_WB_stated[:3, 3], dtype=np.float64)
        self._velocity = np.empty(6)
        # The scene's own numbers: what is in the state's arrays now, whenever it is read.
        self._p_WTip = data.xpos[self._tip]
        self._s_W = data.xmat[self._tip].reshape(3, 3)[:, 2]
        self._p_WShaft = self._p_WTip
        if arm.instrument.wrist is not None:
            wrist = int(model.joint(f"{arm.name}_{WRIST_JOINTS[0]}").bodyid[0])
            self._p_WShaft = data.xpos[wrist]
            self._s_W = data.xmat[model.body_parentid[wrist]].reshape(3, 3)[:, 2]

    def read(self, jaw: float) -> ArmTruth:
        """The truth now, with the jaw angle that the instrument drive reports [rad]."""
        tip = self._R_BW @ (self._p_WTip - self._p_WB)
        axis = self._R_BW @ self._s_W
        mujoco.mj_objectVelocity(
            self._model, self._data, mujoco.mjtObj.mjOBJ_XBODY, self._tip, self._velocity, 0
        )
        return ArmTruth(
            shaft_point=self._R_BW @ (self._p_WShaft - self._p_WB),
            shaft_axis=axis,
            tip=tip,
            tip_velocity=self._R_BW @ self._velocity[3:],
            trocar=self._trocar.undisturbed,
            trocar_loaded=self._trocar.loaded,
            trocar_force=self._trocar.force,
            jaw=jaw,
        )
