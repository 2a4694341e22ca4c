"""The scene: a room in MJCF, arms from URDF, trocars and a patient where the cell says.

Everything is placed by the instrument arm's trocar point and home shaft axis, so that any robot in
any pose finds its patient under its instrument; an arm that holds the endoscope turns the patient
so that it looks along the patient's y axis. URDF is the single source of truth for the arms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import mujoco
import numpy as np

import surg_core
from surg_sim.appearance import room
from surg_sim.appearance.drawing import add_materials
from surg_sim.appearance.patient import add_patient, draw_cannula
from surg_sim.arrays import Array
from surg_sim.physics import endoscope_rig
from surg_sim.physics.patient_site import Site
from surg_sim.physics.pose_error import PoseError
from surg_sim.physics.sim_arm import ToolError, add_arm, robot_part
from surg_sim.physics.tool_drive import add_tool_drive
from surg_sim.physics.trocar import TrocarParameters, add_trocar, shaft_in_flange, wall_frame

WORK_DEPTH = 0.120
"""Depth of the work point behind the trocar [m]: the home tip of the bundled cells."""
ENDOSCOPE = endoscope_rig.LEFT
"""Name of the (left) endoscope camera, and of its optical frame on the wire."""
OVERVIEW = room.OVERVIEW
"""Name of the camera that looks at the room."""
PATIENT = 0.35
"""Largest distance of the endoscope's trocar from the instrument's [m]."""
VIEW_NEAR = 0.02
"""Smallest distance of the work point from the endoscope's lenses [m]."""
HOME_MISS = 0.010
"""Largest distance of the shaft from its trocar at home [m]: the wall gives way by as much."""


def site_of(arms: list[surg_core.Arm]) -> Site:
    """The site that the trocars and home postures of arms define."""
    scope = endoscope_rig.holder(arms)
    arm = next((arm for arm in arms if arm is not scope), arms[0])
    trocar, s = wall_frame(arm)
    away = trocar - arm.X_WB_stated[:3, 3]
    away[2] = 0.0
    length = np.linalg.norm(away)
    x = away / length if length > 0.05 else np.array([1.0, 0.0, 0.0])
    if scope is not None:
        view = wall_frame(scope)[1]
        across = np.cross(view, [0.0, 0.0, 1.0])
        if np.linalg.norm(across) > 0.05:  # else it looks straight down: any way round will do
            x = across / np.linalg.norm(across)
    y = np.cross([0.0, 0.0, 1.0], x)
    ordered = [arm, *(other for other in arms if other is not arm)]
    return Site(
        work=trocar + WORK_DEPTH * s,
        trocar=trocar,
        base=np.array(arm.X_WB_stated[:3, 3]),
        R=np.column_stack([x, y, [0.0, 0.0, 1.0]]),
        ports=np.array([wall_frame(other)[0] for other in ordered]),
        bases=np.array([other.X_WB_stated[:3, 3] for other in ordered]),
    )


def choose_arms(cell: surg_core.Cell, names: Iterable[str] | None) -> list[surg_core.Arm]:
    """The arms to simulate: those named, or all of the cell.

    Raises:
        ValueError: A name is not in the cell, or no arm is left.
    """
    wanted = list(names) if names else list(cell.arms)
    unknown = [name for name in wanted if name not in cell.arms]
    if unknown or not wanted:
        raise ValueError(
            f"no arm {unknown} in the cell '{cell.config.name}': it has {list(cell.arms)}"
        )
    return [cell.arms[name] for name in wanted]


def check_reach(arms: Iterable[surg_core.Arm]) -> None:
    """Refuse arms that do not stand at their trocars, or at one patient: an episode begins there.

    Raises:
        ValueError: The reason, what is allowed, and what to change.
    """
    arms = list(arms)
    for arm in arms:
        p_WRcm, s = wall_frame(arm)
        p_FTip, _ = shaft_in_flange(arm)
        X_BF = np.asarray(arm.chain.forward(np.asarray(arm.robot.home)))
        X_WB = arm.X_WB_stated
        tip = X_WB[:3, :3] @ (X_BF[:3, :3] @ p_FTip + X_BF[:3, 3]) + X_WB[:3, 3]
        depth = float(s @ (tip - p_WRcm))
        off = float(np.linalg.norm(tip - p_WRcm - depth * s))
        limits = arm.limits
        far = float(np.linalg.norm(np.asarray(arm.trocar.p_BRcm)))
        where = (
            f"arm {arm.name}: its trocar, {far:.2f} m from the base, is out of reach of the home "
            "posture: "
        )
        advice = (
            "; move the arm's base, give the arm another 'home' in cell.yaml, or teach the trocar "
            f"anew (calibration/trocar_{arm.name}.yaml)"
        )
        if off > HOME_MISS:
            raise ValueError(
                f"{where}the shaft passes {1000 * off:.1f} mm beside it; allowed are "
                f"{1000 * HOME_MISS:.0f} mm{advice}"
            )
        if not limits.depth_min <= depth <= limits.depth_max:
            raise ValueError(
                f"{where}the tip is {1000 * depth:.0f} mm behind it; allowed are "
                f"{1000 * limits.depth_min:.0f} to {1000 * limits.depth_max:.0f} mm{advice}"
            )
    scope = endoscope_rig.holder(arms)
    for arm in arms:
        if scope is not None and arm is not scope:
            _check_patient(arm, scope)


def _check_patient(arm: surg_core.Arm, scope: surg_core.Arm) -> None:
    """Refuse an instrument and an endoscope that are not in one abdomen."""
    p_WRcm, s = wall_frame(arm)
    work = p_WRcm + WORK_DEPTH * s
    p_WScope, view = wall_frame(scope)
    apart = float(np.linalg.norm(p_WScope - p_WRcm))
    advice = (
        f"; move arms.{scope.name}.base (or .home) in cell.yaml, or search by "
        "python3 -m surg_sim.placement.base_placement"
    )
    if apart > PATIENT:
        raise ValueError(
            f"the trocars of {arm.name} and {scope.name} are {apart:.2f} m apart; allowed are "
            f"{PATIENT:.2f} m, one patient{advice}"
        )
    p_FTip, _ = shaft_in_flange(scope)
    X_WF = scope.X_WB_stated @ np.asarray(scope.chain.forward(np.asarray(scope.robot.home)))
    to_work = work - (X_WF[:3, :3] @ p_FTip + X_WF[:3, 3])
    ahead = float(view @ to_work)
    beside = float(np.linalg.norm(to_work - ahead * view))
    camera = scope.instrument.camera
    assert camera is not None
    if ahead < VIEW_NEAR or beside > ahead * np.tan(camera.fovy / 2.0):
        raise ValueError(
            f"the endoscope of {scope.name} does not see where {arm.name} works: from its lenses "
            f"that is {1000 * ahead:.0f} mm ahead and {1000 * beside:.0f} mm to the side; allowed "
            f"are {1000 * VIEW_NEAR:.0f} mm ahead or more, within {np.degrees(camera.fovy) / 2:.0f}"
            f" degrees of the view's axis{advice}"
        )


def build(
    arms: list[surg_core.Arm],
    seed: int = 0,
    visuals: bool = False,
    trocar: TrocarParameters | None = None,
    tool_errors: Mapping[str, ToolError] | None = None,
    camera_error: PoseError | None = None,
    add: Callable[[mujoco.MjSpec, Site], None] | None = None,
) -> mujoco.MjModel:
    """Compile the scene once; parameters as for ``World``.

    The first arm that holds no endoscope places the patient. ``add`` puts what a task needs into
    the scene, after arms and trocars. Without visuals it lacks what only pictures need.

    Raises:
        ValueError: A URDF does not fit its YAML, or an arm does not reach its trocar.
    """
    check_reach(arms)
    errors = tool_errors or {}
    # Beside this file, not importlib.resources: catkin's devel space relays code but no data files.
    empty = Path(__file__).with_name("assets") / "scene.xml"
    spec = mujoco.MjSpec.from_string(empty.read_text("utf-8"))
    for arm in arms:
        add_arm(spec, arm, errors.get(arm.name))
        add_tool_drive(spec, arm)
    scope = endoscope_rig.holder(arms)
    if scope is not None:
        endoscope_rig.add_held(spec, scope, camera_error)
    for arm in arms:
        add_trocar(spec, arm, trocar or TrocarParameters(), errors.get(arm.name))
    site = site_of(arms)
    if add is not None:
        add(spec, site)
    if scope is None:
        endoscope_rig.add_standing(spec, site, visuals)
    if visuals:
        rng = np.random.default_rng(seed)
        add_materials(spec, rng)
        seen = _home_points(spec.compile(), arms)
        room.add_room(spec, site)
        add_patient(spec, site, rng)
        for arm in arms:
            _add_cannula(spec, arm)
        room.add_overview(spec, site, seen)
    return spec.compile()


def _add_cannula(spec: mujoco.MjSpec, arm: surg_core.Arm) -> None:
    """The cannula in the wall: it turns with the shaft in it, and does not slide with it."""
    bore = 0.007 if arm.instrument.camera is not None else 0.0045
    sleeve = spec.body(f"{arm.name}/sleeve")
    draw_cannula(sleeve, np.array(spec.joint(f"{arm.name}/sleeve").axis), bore)


def _home_points(model: mujoco.MjModel, arms: list[surg_core.Arm]) -> Array:
    """Where the links of all arms are at home, (n, 3), world [m]."""
    data = mujoco.MjData(model)
    for arm in arms:
        for name, angle in zip(arm.robot.joint_names, arm.robot.home, strict=True):
            data.qpos[model.joint(robot_part(arm, name)).qposadr[0]] = angle
    mujoco.mj_kinematics(model, data)
    return np.array(data.xpos[1:])
