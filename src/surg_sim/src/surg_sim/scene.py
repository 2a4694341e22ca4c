"""The scene: a room in MJCF, arms from URDF, trocars and a patient where the cell says.

Everything is placed by the instrument arm's trocar point and home shaft axis, so that any robot in
any pose finds its patient under its instrument; an arm that holds the endoscope turns the patient
so that it looks along the patient's y axis. URDF is the single source of truth for the arms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from surg_sim import anatomy, endoscope, textures
from surg_sim.arm import ActuatorParameters, ToolError, add_arm, quaternion
from surg_sim.jaw import add_jaw
from surg_sim.trocar import TrocarParameters, add_trocar, shaft_in_flange, wall_frame

if TYPE_CHECKING:
    import surg_core

Array = NDArray[np.float64]

WORK_DEPTH = 0.120
"""Depth of the work point behind the trocar [m]: the home tip of the bundled cells."""
ENDOSCOPE = endoscope.LEFT
"""Name of the (left) endoscope camera, and of its optical frame on the wire."""
OVERVIEW = "overview"
"""Name of the camera that looks at the room."""

HOME_MISS = 0.010
"""Largest distance of the shaft from its trocar at home [m]: the wall gives way by as much."""

OUTSIDE = 2
"""Group of geoms that the endoscope cannot see: room, drape, skin. (URDF visuals: group 1.)"""

_SCOPE_DISTANCE = 0.100  # [m] camera to work point
_SCOPE_ELEVATION = np.radians(38.0)  # above the horizontal
_BED_DEPTH = 0.056  # [m] work point to the tissue bed: below every bundled motion


@dataclass(frozen=True)
class Site:
    """Where things are, in the world frame; derived from the arms' trocars and home axes.

    Attributes:
        work: Work point, WORK_DEPTH behind the trocar along the home shaft axis, (3,) [m].
        trocar: Trocar point, (3,) [m].
        base: Origin of the arm's base, (3,) [m].
        R: Patient axes as columns, (3, 3): z up, y horizontal as the endoscope looks. Where no arm
            holds it, x points away from the robot.
        ports: Trocar points of all arms, the instrument's first, (k, 3) [m].
    """

    work: Array
    trocar: Array
    base: Array
    R: Array
    ports: Array

    def place(self, offset: Iterable[float]) -> Array:
        """World position of a point given in patient axes from the work point [m], (3,)."""
        return np.asarray(self.work + self.R @ np.asarray(list(offset)))

    def local(self, point: Array) -> Array:
        """The inverse of ``place``."""
        return np.asarray(self.R.T @ (point - self.work))


def site_of(arms: list[surg_core.Arm]) -> Site:
    """The site that the trocars and home postures of arms define."""
    scope = endoscope.holder(arms)
    arm = next((arm for arm in arms if arm is not scope), arms[0])
    trocar, s = wall_frame(arm)
    away = trocar - arm.X_WB[:3, 3]
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
        base=np.array(arm.X_WB[:3, 3]),
        R=np.column_stack([x, y, [0.0, 0.0, 1.0]]),
        ports=np.array([wall_frame(other)[0] for other in ordered]),
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
    """Refuse arms that do not stand at their trocars: every episode begins there.

    Raises:
        ValueError: The shaft misses the trocar at home, or its tip is not as deep as it may be.
    """
    for arm in arms:
        p_WRcm, s = wall_frame(arm)
        p_FTip, _ = shaft_in_flange(arm)
        X_BF = np.asarray(arm.chain.forward(np.asarray(arm.robot.home)))
        tip = arm.X_WB[:3, :3] @ (X_BF[:3, :3] @ p_FTip + X_BF[:3, 3]) + arm.X_WB[:3, 3]
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


def build(
    arms: list[surg_core.Arm],
    seed: int = 0,
    looks: bool = False,
    actuators: ActuatorParameters | None = None,
    trocar: TrocarParameters | None = None,
    tool_errors: Mapping[str, ToolError] | None = None,
    add: Callable[[mujoco.MjSpec, Site], None] | None = None,
) -> mujoco.MjModel:
    """Compile the scene once.

    Args:
        arms: The arms; the first one that holds no endoscope places the patient.
        seed: Seeds the look of the tissue.
        looks: False leaves out everything that only pictures need; the physics is the same.
        actuators: Drive parameters.
        trocar: Wall parameters.
        tool_errors: By arm name, how the true tool differs from its URDF.
        add: Puts more into the scene, after arms and trocars: what a task needs.

    Raises:
        ValueError: A URDF does not fit its YAML, or an arm does not reach its trocar.
    """
    check_reach(arms)
    errors = tool_errors or {}
    # Beside this file, not importlib.resources: catkin's devel space relays code but no data files.
    room = Path(__file__).with_name("assets") / "scene.xml"
    spec = mujoco.MjSpec.from_string(room.read_text("utf-8"))
    for arm in arms:
        add_arm(spec, arm, actuators or ActuatorParameters(), errors.get(arm.name))
        add_jaw(spec, arm)
    scope = endoscope.holder(arms)
    if scope is not None:
        endoscope.add_held(spec, scope)
    for arm in arms:
        add_trocar(spec, arm, trocar or TrocarParameters(), errors.get(arm.name))
    site = site_of(arms)
    if add is not None:
        add(spec, site)
    if scope is None:
        _add_endoscope(spec, site, looks)
    if looks:
        rng = np.random.default_rng(seed)
        _add_materials(spec, rng)
        seen = _home_points(spec.compile(), arms)
        _add_room(spec, site)
        _add_patient(spec, site, rng)
        for arm in arms:
            _add_cannula(spec, arm)
        _add_overview(spec, site, seen)
    return spec.compile()


# --- looks ------------------------------------------------------------------------------------


def _add_materials(spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
    wet = {"specular": 0.55, "shininess": 0.75}
    dry = {"specular": 0.12, "shininess": 0.2}
    for make, gloss in (
        (textures.fat, wet),
        (textures.bowel, wet),
        (textures.peritoneum, wet),
        (textures.skin, dry),
        (textures.cloth, dry),
    ):
        name = make.__name__
        picture = make(512, rng)
        spec.add_texture(
            name=name,
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            width=picture.shape[1],
            height=picture.shape[0],
            nchannel=3,
            data=picture.ravel(),
        )
        material = spec.add_material(name=name, **gloss)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


def _add_mesh(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    mesh: anatomy.Mesh,
    material: str,
    group: int = 0,
) -> None:
    """A fixed surface that is only seen."""
    spec.add_mesh(
        name=name,
        uservert=mesh.vertices.ravel(),
        userface=mesh.faces.ravel(),
        usertexcoord=mesh.uv.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        smoothnormal=1,
    )
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        material=material,
        group=group,
        contype=0,
        conaffinity=0,
        mass=0.0,
    )


def _add_seen(body: mujoco.MjsBody, type_: mujoco.mjtGeom, material: str, **keys: object) -> None:
    """A primitive that is only seen, from outside."""
    body.add_geom(
        type=type_,
        material=material,
        group=OUTSIDE,
        contype=0,
        conaffinity=0,
        mass=0.0,
        **keys,
    )


@dataclass(frozen=True)
class _Table:
    """The table top in patient axes about the work point [m]: edges in x, half length in y."""

    near: float
    far: float
    half: float


def _table(site: Site) -> _Table:
    """As wide as the robot beside it allows."""
    reach = float(np.hypot(*(site.work - site.base)[:2]))
    return _Table(near=-float(np.clip(reach - 0.13, 0.15, 0.32)), far=0.34, half=0.62)


def wall_height(site: Site, x: float, y: float) -> float:
    """Height of the abdominal wall above the work point at a place in patient axes [m]."""
    dome = _dome(site)
    radius = min((x / dome.half_length) ** 2 + (y / dome.half_width) ** 2, 1.0)
    return float(dome.height * np.sqrt(1.0 - radius)) - _BED_DEPTH


def _dome(site: Site) -> anatomy.Dome:
    """The wall over the bed, as high as it must be to pass through the trocar."""
    x, y, z = site.local(site.trocar)
    half_length, half_width = min(0.180, -_table(site).near - 0.012), 0.225
    radius = min((x / half_length) ** 2 + (y / half_width) ** 2, 0.8)
    return anatomy.Dome(
        half_length=half_length,
        half_width=half_width,
        height=float((z + _BED_DEPTH) / np.sqrt(1.0 - radius)),
        window=np.radians(50.0),
        window_top=np.radians(50.0),
    )


_LOOPS = {
    "near": (0.0125, [(-0.17, 0.036, 0.010), (-0.090, 0.040, 0.011), (-0.052, 0.008, 0.010),
                      (-0.046, -0.038, 0.010), (-0.006, -0.062, 0.011), (0.034, -0.042, 0.011),
                      (0.040, 0.000, 0.012), (0.072, 0.034, 0.011), (0.17, 0.030, 0.010)]),
    "first": (0.0155, [(-0.18, 0.070, 0.014), (-0.08, 0.066, 0.015), (0.0, 0.074, 0.014),
                       (0.085, 0.064, 0.015), (0.18, 0.074, 0.014)]),
    "second": (0.0185, [(-0.18, 0.100, 0.026), (-0.07, 0.106, 0.031), (0.02, 0.100, 0.030),
                        (0.09, 0.108, 0.031), (0.18, 0.100, 0.026)]),
    "third": (0.0215, [(-0.18, 0.135, 0.048), (-0.06, 0.130, 0.058), (0.03, 0.137, 0.060),
                       (0.1, 0.130, 0.056), (0.18, 0.136, 0.048)]),
}  # fmt: skip
"""Pieces of bowel in patient axes about the bed below the work point: radius [m], knots [m]."""


def _add_patient(spec: mujoco.MjSpec, site: Site, rng: np.random.Generator) -> None:
    """Tissue bed, bowel, abdominal wall and drape, in patient axes about the work point."""
    dome, table = _dome(site), _table(site)
    patient = spec.worldbody.add_body(
        name="patient",
        pos=site.place([0, 0, -_BED_DEPTH]).tolist(),
        quat=quaternion(site.R).tolist(),
    )

    def bed(x: Array, y: Array) -> Array:
        hills = 0.0035 * np.sin(41 * x + 1.0) * np.cos(37 * y) + 0.0025 * np.sin(83 * x - 61 * y)
        return hills + 0.05 * np.clip((y - 0.05) / 0.15, 0, 1) ** 1.5

    # What is in front is drawn first, so that what it hides costs nothing.
    for name, (radius, knots) in _LOOPS.items():
        if name == "near" and spec.body("bowel_0") is not None:
            continue  # the living piece lies here
        share = 0.94 - 1.15 * radius / dome.half_length
        centre = dome.inside(anatomy.smooth_curve(np.array(knots), 80), share)
        _add_mesh(spec, patient, f"loop_{name}", anatomy.bowel_loop(centre, radius, rng), "bowel")

    edge = 0.97
    fat = anatomy.disc(bed, edge * dome.half_length, edge * dome.half_width, 0.13)
    _add_mesh(spec, patient, "bed", fat, "fat")
    _add_mesh(spec, patient, "wall_outside", dome.wall(), "skin", OUTSIDE)
    _add_mesh(spec, patient, "wall_inside", dome.wall(60, 20).flipped(), "peritoneum")
    _add_mesh(spec, patient, "wall_rim", dome.rim(0.0055), "skin", OUTSIDE)

    def drape(x: Array, y: Array) -> Array:
        r = np.hypot(x / dome.half_length, y / dome.half_width)
        slope = np.clip((1.85 - r) / 0.85, 0, 1)
        angle = np.arctan2(y, x)
        crease = 0.005 * np.sin(11 * angle + 2.5 * np.sin(2 * angle)) * np.clip(3 * (r - 1), 0, 1)
        over = np.maximum(np.maximum(table.near - x, x - table.far), np.abs(y) - table.half)
        hang = 0.16 * np.clip(over / 0.025, 0, 1)
        within = 0.09 * np.clip(4 * (1.0 - r), 0, 1)
        return 0.072 * slope**2 * (3 - 2 * slope) + crease - 0.072 - hang - within

    x = np.linspace(table.near - 0.03, table.far + 0.03, 111)
    y = np.linspace(-table.half - 0.03, table.half + 0.03, 151)
    _add_mesh(spec, patient, "drape", anatomy.surface(drape, x, y, 0.3), "cloth", OUTSIDE)


def _add_room(spec: mujoco.MjSpec, site: Site) -> None:
    """Ground, operating table and the robot's pedestal."""
    world, table = spec.worldbody, _table(site)
    top = float(site.work[2]) - _BED_DEPTH - 0.080
    ground = min(top, float(site.base[2])) - 0.62
    quat = quaternion(site.R).tolist()
    box, cylinder = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
    _add_seen(world, mujoco.mjtGeom.mjGEOM_PLANE, "ground", pos=[0, 0, ground], size=[8, 8, 0.1])

    bed = world.add_body(name="table", pos=[site.work[0], site.work[1], top], quat=quat)
    middle, half = (table.near + table.far) / 2, (table.far - table.near) / 2
    for material, low, high, x, y in (
        ("mattress", -0.050, 0.0, half, table.half),
        ("table", -0.080, -0.050, half - 0.01, table.half - 0.01),
        ("pedestal", ground - top + 0.06, -0.080, 0.10, 0.16),
        ("table", ground - top, ground - top + 0.06, 0.24, 0.42),
    ):
        size = [x, y, (high - low) / 2]
        _add_seen(bed, box, material, pos=[middle, 0, (low + high) / 2], size=size)

    height = (float(site.base[2]) - ground) / 2
    for material, low, high, radius in (
        ("pedestal", 0.0, 2 * height, 0.09),
        ("table", 0.0, 0.04, 0.24),
        ("table", 2 * height - 0.016, 2 * height - 0.001, 0.115),
    ):
        _add_seen(world, cylinder, material, size=[radius, (high - low) / 2, 0],
                  pos=[site.base[0], site.base[1], ground + (low + high) / 2])  # fmt: skip


def _add_cannula(spec: mujoco.MjSpec, arm: surg_core.Arm) -> None:
    """The cannula in the wall; it moves with the wall, not with the shaft."""
    _, s_W = wall_frame(arm)
    draw_cannula(spec.body(f"{arm.name}_wall"), arm.X_WB[:3, :3].T @ s_W)


def draw_cannula(wall: mujoco.MjsBody, axis: Array) -> None:
    """Draw a cannula on a body whose origin is the trocar point.

    Args:
        wall: The body.
        axis: Unit vector into the patient, in the body's axes, (3,).
    """
    cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER

    def ring(start: float, end: float, radius: float, material: str) -> None:
        _add_seen(wall, cylinder, material, fromto=[*(start * axis), *(end * axis)],
                  size=[radius, 0, 0])  # fmt: skip

    ring(-0.030, 0.022, 0.0045, "cannula")
    ring(-0.046, -0.028, 0.0095, "seal")
    ring(-0.050, -0.046, 0.0105, "cannula")
    ring(-0.003, 0.003, 0.0085, "hole")


def _look(forward: Array, up: Array) -> Array:
    """Orientation of a MuJoCo camera (-z forwards, y up), as columns, (3, 3)."""
    z = -forward / np.linalg.norm(forward)
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _add_endoscope(spec: mujoco.MjSpec, site: Site, looks: bool) -> None:
    """A camera that stands still, its light, and (for pictures) the scope behind it."""
    eye = site.place(
        _SCOPE_DISTANCE * np.array([0.0, -np.cos(_SCOPE_ELEVATION), np.sin(_SCOPE_ELEVATION)])
    )
    forward = (site.work - eye) / _SCOPE_DISTANCE
    endoscope.add_standing(spec, eye, _look(forward, np.array([0.0, 0.0, 1.0])))
    if not looks:
        return
    world = spec.worldbody
    cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
    for start, end, radius, material in (
        (0.006, 0.260, 0.005, "scope"),
        (0.255, 0.300, 0.013, "scope_head"),
        (0.300, 0.365, 0.020, "scope"),
    ):
        _add_seen(world, cylinder, material, size=[radius, 0, 0],
                  fromto=[*(eye - start * forward), *(eye - end * forward)])  # fmt: skip


def _home_points(model: mujoco.MjModel, arms: list[surg_core.Arm]) -> Array:
    """Where the links of all arms are at home, (n, 3), world [m]."""
    data = mujoco.MjData(model)
    for arm in arms:
        for name, angle in zip(arm.robot.joint_names, arm.robot.home, strict=True):
            data.qpos[model.joint(f"{arm.name}_{name}").qposadr[0]] = angle
    mujoco.mj_kinematics(model, data)
    return np.array(data.xpos[1:])


def _add_overview(spec: mujoco.MjSpec, site: Site, seen: Array) -> None:
    """The spectator, far enough away to see these points (n, 3) and the patient; two lamps."""
    fovy, aspect, margin = 36.0, 16 / 9, 0.10
    corners = [site.place([x, y, -0.05]) for x in (-0.20, 0.24) for y in (-0.34, 0.2)]
    points = np.vstack([seen, corners])
    R = _look(site.R @ np.array([-0.10, 0.90, -0.42]), np.array([0.0, 0.0, 1.0]))
    local = points @ R  # camera axes: x right, y up, z towards the spectator
    middle = (local.min(axis=0) + local.max(axis=0)) / 2
    half = np.tan(np.radians(fovy) / 2) * np.array([aspect, 1.0])
    needed = (np.abs(local[:, :2] - middle[:2]) + margin) / half + local[:, 2:]
    eye = R @ np.array([middle[0], middle[1], needed.max()])
    world = spec.worldbody
    world.add_camera(name=OVERVIEW, pos=eye.tolist(), quat=quaternion(R).tolist(), fovy=fovy)
    for name, place, strength in (
        ("lamp", [0.5, -0.9, 1.7], 0.62),
        ("fill", [-1.2, -0.3, 1.3], 0.28),
    ):
        position = site.place(place)
        direction = site.work - position
        world.add_light(
            name=name,
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=position.tolist(),
            dir=(direction / np.linalg.norm(direction)).tolist(),
            castshadow=False,
            ambient=[0.0, 0.0, 0.0],
            diffuse=[strength] * 3,
            specular=[0.25 * strength] * 3,
        )
