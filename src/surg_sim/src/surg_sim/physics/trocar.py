"""The compliant trocar: a sleeve that slides on the shaft, held by the abdominal wall's springs.

The sleeve is a body on a slide joint along the shaft, with the seal's friction. A connect
constraint between two *sites* ties it to a wall body on three spring-damper slides. (A connect
between bodies takes its anchor at qpos0 and throws the arm.) The wall's displacement is therefore
the position of its slides, and the force of the shaft on the wall is their constraint force.

The trocar point may move by itself (``MovingPoint``). Springs and dampers then act relative to the
moving point.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

import surg_core
from surg_sim.arrays import Array
from surg_sim.physics.sim_arm import ToolError, robot_part, tip_in_flange
from surg_sim.physics.spec_parts import quaternion, state_mass
from surg_sim.physics.trocar_motion import MovingPoint


@dataclass(frozen=True)
class TrocarParameters:
    """Mechanics of the wall at the trocar. Fixed before any deviation is looked at."""

    stiffness: float = 800.0  # of the wall, in its plane and across it alike [N/m]; assumed
    mass: float = 0.05  # of the wall and cannula that move along [kg]; assumed
    damping_ratio: float = 0.7  # of the wall on its springs; assumed
    friction: float = 0.5  # of the seal on the shaft [N]; assumed

    @property
    def damping(self) -> float:
        """Damping coefficient of each spring [N s/m]."""
        return 2.0 * self.damping_ratio * float(np.sqrt(self.stiffness * self.mass))


def shaft_in_flange(arm: surg_core.Arm, error: ToolError | None = None) -> tuple[Array, Array]:
    """True tip p_FTip (3,) [m] and unit shaft axis s_F (3,), flange to tip, by the URDF.

    Not by the calibration; ``error`` is how the true tool differs from the URDF.
    """
    X_FTip = tip_in_flange(arm)
    if error is not None:
        X_FTip = error.mount(X_FTip) @ X_FTip
    return np.array(X_FTip[:3, 3]), np.array(X_FTip[:3, 2])


def wall_frame(arm: surg_core.Arm) -> tuple[Array, Array]:
    """The wall at rest: taught trocar point p_WRcm (3,) [m], home shaft axis s_W (3,), inwards."""
    p_WRcm = arm.X_WB_stated[:3, :3] @ np.asarray(arm.trocar.p_BRcm) + arm.X_WB_stated[:3, 3]
    _, s_F = shaft_in_flange(arm)
    R_BF = arm.chain.forward(np.asarray(arm.robot.home))[:3, :3]
    return p_WRcm, arm.X_WB_stated[:3, :3] @ R_BF @ s_F


def add_trocar(
    spec: mujoco.MjSpec,
    arm: surg_core.Arm,
    parameters: TrocarParameters,
    error: ToolError | None = None,
) -> None:
    """Add the sleeve, the wall and the constraint between them to the scene.

    The wall's axes are those of the arm's base, so that its slides are read in the base frame. The
    sleeve rides on the true shaft, which differs from the URDF by ``error``.
    """
    _add_wall(spec, arm, parameters)
    _add_sleeve(spec, arm, parameters, error)
    spec.add_equality(
        name=f"{arm.name}_trocar",
        type=mujoco.mjtEq.mjEQ_CONNECT,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        name1=f"{arm.name}/sleeve",
        name2=f"{arm.name}/wall",
        solref=[0.004, 1.0],
        solimp=[0.99, 0.999, 1e-4, 0.5, 2.0],
    )


def _add_wall(spec: mujoco.MjSpec, arm: surg_core.Arm, parameters: TrocarParameters) -> None:
    """A body on three spring-damper slides at the taught trocar point."""
    p_WRcm, _ = wall_frame(arm)
    wall = spec.worldbody.add_body(
        name=f"{arm.name}/wall",
        pos=p_WRcm.tolist(),
        quat=quaternion(arm.X_WB_stated[:3, :3]).tolist(),
    )
    state_mass(wall, parameters.mass, [1e-5] * 3)
    for axis, name in zip(np.eye(3), "xyz", strict=True):
        wall.add_joint(
            name=f"{arm.name}/wall_{name}",
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=axis.tolist(),
            stiffness=[parameters.stiffness, 0, 0],
            damping=[parameters.damping, 0, 0],
        )
    wall.add_site(name=f"{arm.name}/wall", size=[0.001] * 3, group=4)


def _add_sleeve(
    spec: mujoco.MjSpec, arm: surg_core.Arm, parameters: TrocarParameters, error: ToolError | None
) -> None:
    """A light body that slides along the true shaft with the seal's dry friction."""
    p_FTip, s_F = shaft_in_flange(arm, error)
    X_BF = arm.chain.forward(np.asarray(arm.robot.home))
    depth = (X_BF[:3, :3] @ s_F) @ (
        X_BF[:3, :3] @ p_FTip + X_BF[:3, 3] - np.asarray(arm.trocar.p_BRcm)
    )
    sleeve = spec.body(robot_part(arm, arm.robot.flange_link)).add_body(
        name=f"{arm.name}/sleeve", pos=(p_FTip - depth * s_F).tolist()
    )
    state_mass(sleeve, 0.01, [1e-6] * 3)
    sleeve.add_joint(
        name=f"{arm.name}/sleeve",
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=s_F.tolist(),
        frictionloss=parameters.friction,
        # Stiff, so that it acts as dry friction; the default is viscous for so light a sleeve.
        solref_friction=[0.002, 1.0],
        solimp_friction=[0.99, 0.999, 1e-4, 0.5, 2.0],
    )
    sleeve.add_site(name=f"{arm.name}/sleeve", size=[0.001] * 3, group=4)


class Trocar:
    """The trocar of one arm in a compiled scene: position, displacement and force."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        arm: surg_core.Arm,
        parameters: TrocarParameters,
    ) -> None:
        self._model, self._data, self._damping = model, data, parameters.damping
        joints = [model.joint(f"{arm.name}/wall_{name}") for name in "xyz"]
        self._qpos = slice(joints[0].qposadr[0], joints[0].qposadr[0] + 3)
        self._dofs = slice(joints[0].dofadr[0], joints[0].dofadr[0] + 3)
        self._sites = [model.site(f"{arm.name}/{name}").id for name in ("sleeve", "wall")]
        self._R_BW = np.asarray(arm.X_WB_stated[:3, :3], dtype=np.float64).T
        self._p_BRcm: Array = np.array(arm.trocar.p_BRcm, dtype=np.float64)
        self.point = MovingPoint(self._p_BRcm)
        """The unloaded trocar point; moves on command, otherwise stays where it was taught."""

    def reset(self) -> None:
        """Put the trocar point where it was taught and the wall where the shaft holds it.

        The scene's kinematics must be up to date with the arm at its home posture.
        """
        self.point.reset()
        self._placed: tuple[Array, Array] | None = None
        self._model.qpos_spring[self._qpos] = 0.0
        self._data.qfrc_applied[self._dofs] = 0.0
        sleeve, wall = (self._data.site_xpos[i] for i in self._sites)
        self._data.qpos[self._qpos] += self._R_BW @ (sleeve - wall)

    def advance(self) -> None:
        """Move the trocar point by one tick; call it before the physics of that tick.

        Spring and damper between wall and moving point: m a = -k (x - x0) - c (v - v0). MuJoCo's
        joint computes k (x - springref) and c v; c v0 is added as an applied force.
        """
        point = self.point
        point.advance()
        if self._placed is not None and self._placed[0] is point.p_B:
            return  # at rest
        self._placed = point.p_B, point.v_B
        self._model.qpos_spring[self._qpos] = point.p_B - self._p_BRcm
        self._data.qfrc_applied[self._dofs] = self._damping * point.v_B

    @property
    def undisturbed(self) -> Array:
        """Unloaded trocar point [m], base frame, (3,)."""
        return self.point.p_B

    @property
    def loaded(self) -> Array:
        """Trocar point under load [m], base frame, (3,)."""
        return self._p_BRcm + self._data.qpos[self._qpos]

    @property
    def displacement(self) -> Array:
        """Loaded minus undisturbed point [m], base frame, (3,)."""
        return self.loaded - self.undisturbed

    @property
    def force(self) -> Array:
        """Force of the shaft on the wall [N], base frame, (3,), of the last MuJoCo step."""
        return np.array(self._data.qfrc_constraint[self._dofs])
