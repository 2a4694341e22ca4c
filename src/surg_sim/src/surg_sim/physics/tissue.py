"""The bowel: a deformable tube of point masses on springs, held by its mesentery.

Every node slides along the three world axes. Tendon springs connect it to its neighbours 1, 2 and 4
nodes away; together they are the stretch stiffness of the wall, and the longer ones also resist
bending. A soft spring per node models the mesentery; it is stiff at both ends, where the tube
continues out of view. Gravity and support cancel at rest, so every random shape is an equilibrium;
a floor carries nodes that are pressed down. Jaw pads touch a soft inner sphere (``tissue_grasp``).

An episode changes only joint positions, spring references and the tendons' rest lengths.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from surg_sim.appearance.anatomy import smooth_curve
from surg_sim.arrays import Array
from surg_sim.physics.patient_site import Site
from surg_sim.physics.spec_parts import quaternion, state_mass

NAME = "bowel"
"""Prefix of everything of the bowel in a scene."""
FLOOR_BIT = 1 << 8
"""Contact bit of the floor; those of the tools follow (``grasp``)."""
TOOL_BITS = sum(1 << (9 + i) for i in range(4))
"""Contact bits of all tools."""

_REACHES = (1, 2, 4)  # neighbours that a node is tied to
_SHARES = np.array([500.0, 160.0, 80.0])  # their stiffnesses, as a ratio
_DIP = 0.010  # [m] by which the ends dive out of sight
_KNOTS = np.array(
    [(-0.150, 0.062), (-0.105, 0.052), (-0.066, 0.028), (-0.036, 0.000), (0.000, -0.012),
     (0.036, 0.000), (0.066, 0.028), (0.105, 0.052), (0.150, 0.062)]
)  # fmt: skip
"""Course of the tube in patient axes about the work point, x and y [m]."""


@dataclass(frozen=True)
class TissueParameters:
    """Mechanics of the bowel, fixed before any deviation is looked at.

    Their sources stand in ``patient_settings``.
    """

    nodes: int = 36  # number of point masses
    spacing: float = 0.0086  # of the nodes along the tube [m]
    radius: float = 0.0115  # of the tube [m]
    mass: float = 0.216  # of the whole tube [kg]
    stretch: float = 21.0  # force per strain of the tube, modulus times wall section [N]
    damping: float = 0.002  # of a stretched tube, as the time in which stress relaxes [s]
    mesentery: float = 2.2  # stiffness that holds a node where it rests [N/m]
    mesentery_damping: float = 0.12  # [N s/m] per node
    anchor: float = 60.0  # stiffness at the two ends, where the tube goes on [N/m]
    height: float = -0.040  # of the tube's axis above the work point [m]
    slip_force: float = 3.0  # pull at which the tissue slips in closed jaws [N]
    # Amplitude of the longest of three random waves in the course; the others are a half and a
    # third of it [m].
    bend: float = 0.010
    shift: float = 0.008  # largest random displacement of the whole [m]
    turn: float = 0.15  # largest random turn of the whole about the vertical [rad]

    @property
    def springs(self) -> Array:
        """Stiffness of the springs to the neighbours 1, 2, 4 [N/m], (3,).

        A spring over r spacings acts in r of them side by side: sum r^2 k_r = stretch / spacing.
        """
        reach = np.array(_REACHES)
        return np.asarray(_SHARES * self.stretch / self.spacing / (_SHARES @ reach**2))


def rest_shape(
    site: Site, parameters: TissueParameters, rng: np.random.Generator | None = None
) -> Array:
    """Where the nodes rest in the world, (n, 3) [m]; ``rng`` draws the random part, None: none."""
    knots = np.column_stack([_KNOTS, np.full(len(_KNOTS), parameters.height)])
    if rng is not None:
        # Long waves only: a bend sharper than the tube's radius would be a kink.
        along, order = np.linspace(0.0, 1.0, len(knots))[:, None], np.arange(1, 4)
        for axis in range(2):
            size = rng.uniform(-parameters.bend, parameters.bend, 3) / order
            phase = rng.uniform(0.0, 2.0 * np.pi, 3)
            knots[:, axis] += np.sin(np.pi * order * along + phase) @ size
        angle = rng.uniform(-parameters.turn, parameters.turn)
        c, s = np.cos(angle), np.sin(angle)
        knots[:, :2] = knots[:, :2] @ np.array([[c, s], [-s, c]])
        knots[:, :2] += rng.uniform(-parameters.shift, parameters.shift, 2)
    curve = smooth_curve(knots, 400)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    place = (np.arange(parameters.nodes) - (parameters.nodes - 1) / 2) * parameters.spacing
    place += length[-1] / 2
    local = np.column_stack([np.interp(place, length, curve[:, i]) for i in range(3)])
    # The curve is longer than the tube for every draw; were it not, the ends would coincide.
    ends = np.minimum(np.arange(parameters.nodes), np.arange(parameters.nodes)[::-1])
    local[:, 2] -= _DIP * np.clip(1.0 - ends / 4.0, 0.0, 1.0) ** 2
    return np.asarray(site.work + local @ site.R.T)


def springs_of(n: int) -> list[tuple[int, int, int]]:
    """The springs: (kind, node, node further on)."""
    return [(k, i, i + r) for k, r in enumerate(_REACHES) for i in range(n - r)]


def add_bowel(spec: mujoco.MjSpec, site: Site, parameters: TissueParameters) -> None:
    """Add the bowel and the floor below it to the scene; switches contacts on."""
    spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for i, place in enumerate(rest_shape(site, parameters)):
        _add_node(spec, i, place, parameters)
    for rank, a, b in springs_of(parameters.nodes):
        stiffness = float(parameters.springs[rank])
        spring = spec.add_tendon(
            name=f"{NAME}_{a}_{b}",
            stiffness=[stiffness, 0, 0],
            damping=[parameters.damping * stiffness, 0, 0],
            group=4,
        )
        spring.wrap_site(f"{NAME}_{a}")
        spring.wrap_site(f"{NAME}_{b}")
    floor = spec.worldbody.add_body(
        name=f"{NAME}_floor",
        mocap=True,
        pos=floor_place(site, parameters).tolist(),
        quat=quaternion(site.R).tolist(),
    )
    floor.add_geom(
        name=f"{NAME}_floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.3, 0.3, 0.01],
        group=4,
        contype=FLOOR_BIT,
        conaffinity=0,
        condim=1,
    )


def _add_node(spec: mujoco.MjSpec, i: int, place: Array, parameters: TissueParameters) -> None:
    """A point mass on three slides, with a sphere for the floor and one for the jaw pads."""
    p, to_end = parameters, min(i, parameters.nodes - 1 - i)
    node = spec.worldbody.add_body(name=f"{NAME}_{i}", pos=place.tolist())
    state_mass(node, p.mass / p.nodes, [1e-6] * 3)
    for axis, letter in zip(np.eye(3), "xyz", strict=True):
        node.add_joint(
            name=f"{NAME}_{i}_{letter}",
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=axis.tolist(),
            stiffness=[p.anchor if to_end < 2 else p.mesentery, 0, 0],
            damping=[p.mesentery_damping, 0, 0],
        )
    node.add_site(name=f"{NAME}_{i}", size=[0.001] * 3, group=4)
    for kind, radius, bits in (
        ("outer", p.radius, FLOOR_BIT if to_end >= 4 else 0),
        ("inner", 0.72 * p.radius, TOOL_BITS),
    ):
        node.add_geom(
            name=f"{NAME}_{i}_{kind}",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[radius, 0, 0],
            group=4,
            mass=0.0,
            contype=0,
            conaffinity=bits,
            condim=1,
            solref=[0.02, 1.0],
            solimp=[0.0, 0.95, 0.004, 0.5, 2.0],
        )


def floor_place(site: Site, parameters: TissueParameters) -> Array:
    """A point of the floor in the world, a little below the resting tube [m]."""
    return site.place([0.0, 0.0, parameters.height - parameters.radius - 0.0015])
