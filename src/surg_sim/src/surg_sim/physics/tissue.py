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
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from surg_sim.looks.anatomy import smooth_curve
from surg_sim.physics.sim_arm import quaternion
from surg_sim.physics.trocar_motion import MovingPoint

if TYPE_CHECKING:
    from surg_sim.physics.scene import Site

Array = NDArray[np.float64]

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
    """Mechanics of the bowel. Fixed before any deviation is looked at; sources in ``conditions``.

    Attributes:
        nodes: Number of point masses.
        spacing: Of the nodes along the tube [m].
        radius: Of the tube [m].
        mass: Of the whole tube [kg].
        stretch: Force per strain of the tube, modulus times wall section [N].
        damping: Of a stretched tube, as the time in which stress relaxes [s].
        mesentery: Stiffness that holds a node where it rests [N/m].
        mesentery_damping: [N s/m] per node.
        anchor: Stiffness at the two ends, where the tube goes on [N/m].
        height: Of the tube's axis above the work point [m].
        slip_force: Pull at which the tissue slips in closed jaws [N].
        bend: Amplitude of the longest of three random waves in the course; the others are a half
            and a third of it [m].
        shift: Largest random displacement of the whole [m].
        turn: Largest random turn of the whole about the vertical [rad].
    """

    nodes: int = 36
    spacing: float = 0.0086
    radius: float = 0.0115
    mass: float = 0.216
    stretch: float = 21.0
    damping: float = 0.002
    mesentery: float = 2.2
    mesentery_damping: float = 0.12
    anchor: float = 60.0
    height: float = -0.040
    slip_force: float = 3.0
    bend: float = 0.010
    shift: float = 0.008
    turn: float = 0.15

    @property
    def springs(self) -> Array:
        """Stiffness of the springs to the neighbours 1, 2, 4 [N/m], (3,).

        A spring over r spacings acts in r of them side by side: sum r^2 k_r = stretch / spacing.
        """
        reach = np.array(_REACHES)
        return np.asarray(_SHARES * self.stretch / self.spacing / (_SHARES @ reach**2))

    @property
    def collision_radius(self) -> float:
        """Of the soft sphere in every node that jaw pads meet [m]."""
        return 0.72 * self.radius


def rest_shape(
    site: Site, parameters: TissueParameters, rng: np.random.Generator | None = None
) -> Array:
    """Where the nodes rest in the world, (n, 3) [m].

    Args:
        site: The patient.
        parameters: Size and range of the random part.
        rng: Draws shape and place; None: the shape without a random part.
    """
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


def _pairs(n: int) -> list[tuple[int, int, int]]:
    """The springs: (kind, node, node further on)."""
    return [(k, i, i + r) for k, r in enumerate(_REACHES) for i in range(n - r)]


def add_bowel(spec: mujoco.MjSpec, site: Site, parameters: TissueParameters, looks: bool) -> None:
    """Add the bowel and the floor below it to the scene; switches contacts on.

    Args:
        spec: The scene.
        site: The patient.
        parameters: Mechanics.
        looks: Also add the skin that ``BowelSkin`` draws.
    """
    spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for i, place in enumerate(rest_shape(site, parameters)):
        _add_node(spec, i, place, parameters)
    for rank, a, b in _pairs(parameters.nodes):
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
        pos=_floor(site, parameters).tolist(),
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
    if looks:
        from surg_sim.looks.tissue_skin import add_skin

        add_skin(spec, site, parameters)


def _add_node(spec: mujoco.MjSpec, i: int, place: Array, parameters: TissueParameters) -> None:
    """A point mass on three slides, with a sphere for the floor and one for the jaw pads."""
    p, to_end = parameters, min(i, parameters.nodes - 1 - i)
    node = spec.worldbody.add_body(name=f"{NAME}_{i}", pos=place.tolist())
    node.gravcomp = 1.0
    node.mass = p.mass / p.nodes
    node.inertia = [1e-6] * 3
    node.explicitinertial = True
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
        ("inner", p.collision_radius, TOOL_BITS),
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


def _floor(site: Site, parameters: TissueParameters) -> Array:
    """A point of the floor in the world, a little below the resting tube [m]."""
    return site.place([0.0, 0.0, parameters.height - parameters.radius - 0.0015])


class Bowel:
    """The bowel in a compiled scene.

    Args:
        model: The compiled scene.
        data: Its state.
        site: The patient.
        parameters: What ``add_bowel`` was given.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        site: Site,
        parameters: TissueParameters,
    ) -> None:
        self._model, self._data, self._site = model, data, site
        self.parameters = parameters
        n = parameters.nodes
        first = model.joint(f"{NAME}_0_x")
        self._qpos = slice(int(first.qposadr[0]), int(first.qposadr[0]) + 3 * n)
        self._dofs = slice(int(first.dofadr[0]), int(first.dofadr[0]) + 3 * n)
        self._base = rest_shape(site, parameters)
        pairs = _pairs(n)
        tendon = int(model.tendon(f"{NAME}_{pairs[0][1]}_{pairs[0][2]}").id)
        self._tendons = slice(tendon, tendon + len(pairs))
        self._kinds, self._from, self._to = np.array(pairs).T
        self._stiffness = parameters.springs[self._kinds]
        # crossing[i, t]: spring t passes the cut between node i and node i + 1.
        cut = np.arange(n - 1)[:, None]
        self._crossing = ((self._from <= cut) & (cut < self._to)).astype(np.float64)
        self._joints = slice(int(first.id), int(first.id) + 3 * n)
        self._mocap = int(model.body(f"{NAME}_floor").mocapid[0])
        self.sites = np.array([model.site(f"{NAME}_{i}").id for i in range(n)])
        """Site of every node, (n,)."""
        self.outer = np.array([model.geom(f"{NAME}_{i}_outer").id for i in range(n)])
        """Geom of every node that the floor meets, (n,)."""
        self.inner = np.array([model.geom(f"{NAME}_{i}_inner").id for i in range(n)])
        """Geom of every node that jaw pads meet, (n,)."""
        self._affinity = np.array(model.geom_conaffinity)
        self.bed = MovingPoint(np.zeros(3))
        """Where what carries the bowel is, relative to its place at rest [m], world."""
        self.reset()

    def reset(self, rng: np.random.Generator | None = None) -> None:
        """At rest in a new shape, held by nobody; the bed is still.

        Args:
            rng: Draws the shape; None: the one without a random part.
        """
        self.bed.reset()
        self._motion = np.zeros(6)
        shape = self._base if rng is None else rest_shape(self._site, self.parameters, rng)
        self._rest = shape - self._base
        self._model.qpos_spring[self._qpos] = self._rest.ravel()
        self._data.qpos[self._qpos] = self._rest.ravel()
        self._data.qvel[self._dofs] = 0.0
        self._data.qfrc_applied[self._dofs] = 0.0
        length = np.linalg.norm(shape[self._to] - shape[self._from], axis=1)
        self._model.tendon_lengthspring[self._tendons] = length[:, None]
        self._holders: dict[int, int] = {}  # node: contact bit of the tool that holds it
        self._set_contacts()
        self._place_floor()

    def advance(self) -> None:
        """Move what carries the bowel one tick on; called before the physics of that tick."""
        still = self.bed.p_B
        self.bed.advance()
        if self.bed.p_B is still:
            return
        motion = np.append(self.bed.p_B, self.bed.v_B)
        if np.array_equal(motion, self._motion):
            return
        self._motion = motion
        rest = self._rest + self.bed.p_B
        self._model.qpos_spring[self._qpos] = rest.ravel()
        # The mesentery's dampers act on the difference to the moving bed.
        drag = self.parameters.mesentery_damping * self.bed.v_B
        self._data.qfrc_applied[self._dofs] = np.tile(drag, self.parameters.nodes)
        self._place_floor()

    def _place_floor(self) -> None:
        self._data.mocap_pos[self._mocap] = _floor(self._site, self.parameters) + self.bed.p_B

    @property
    def nodes(self) -> Array:
        """Places of the nodes in the world [m], (n, 3)."""
        return self._base + self._data.qpos[self._qpos].reshape(-1, 3)

    @property
    def velocities(self) -> Array:
        """Velocities of the nodes in the world [m/s], (n, 3)."""
        return np.array(self._data.qvel[self._dofs].reshape(-1, 3))

    @property
    def tensions(self) -> Array:
        """Elastic tension in every piece of the tube from node i to i + 1 [N], (n - 1,).

        The sum over all springs that cross the cut; negative: compressed.
        """
        return np.asarray(self._crossing @ (self._stiffness * self._stretch()))

    def _stretch(self) -> Array:
        """Elongation of every spring [m]."""
        nodes = self.nodes
        length = np.linalg.norm(nodes[self._to] - nodes[self._from], axis=1)
        return np.asarray(length - self._model.tendon_lengthspring[self._tendons, 0])

    @property
    def pulls(self) -> Array:
        """Force of mesentery and anchors on every node [N], world, (n, 3)."""
        stiffness = self._model.jnt_stiffness[self._joints].reshape(-1, 3)
        moved = self._data.qpos[self._qpos] - self._model.qpos_spring[self._qpos]
        return np.asarray(-stiffness * moved.reshape(-1, 3))

    def held_force(self, node: int) -> Array:
        """Force of constraints (a grasp) on a node in the last MuJoCo step [N], world, (3,)."""
        start = self._dofs.start + 3 * node
        return np.array(self._data.qfrc_constraint[start : start + 3])

    @property
    def energy(self) -> float:
        """Elastic and kinetic energy [J]."""
        moved = self._data.qpos[self._qpos] - self._model.qpos_spring[self._qpos]
        mass = self.parameters.mass / self.parameters.nodes
        speed = self._data.qvel[self._dofs]
        springs = self._stiffness @ self._stretch() ** 2
        held = self._model.jnt_stiffness[self._joints] @ moved**2
        return float(springs + held + mass * speed @ speed) / 2

    def free(self, node: int) -> bool:
        """Whether no tool holds this node."""
        return node not in self._holders

    def hold(self, node: int, tool_bit: int) -> None:
        """A tool holds this node: its jaws no longer push it and its neighbours away.

        Args:
            node: The node.
            tool_bit: Contact bit of the tool's pads.
        """
        self._holders[node] = tool_bit
        self._set_contacts()

    def release(self, node: int) -> None:
        """The tool that holds this node lets go."""
        del self._holders[node]
        self._set_contacts()

    def _set_contacts(self) -> None:
        """What meets what: a held node nothing, its neighbours not the jaws that hold it."""
        affinity, geoms = self._model.geom_conaffinity, np.append(self.outer, self.inner)
        affinity[geoms] = self._affinity[geoms]
        for node, bit in self._holders.items():
            for beside in range(max(node - 1, 0), min(node + 2, self.parameters.nodes)):
                affinity[self.inner[beside]] &= ~bit
        for node in self._holders:
            affinity[self.outer[node]] = affinity[self.inner[node]] = 0
