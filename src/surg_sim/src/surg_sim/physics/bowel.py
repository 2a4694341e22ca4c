"""The bowel in a compiled scene: shapes, tensions, and who holds which node."""

from __future__ import annotations

import mujoco
import numpy as np

from surg_sim.arrays import Array
from surg_sim.physics.patient_site import Site
from surg_sim.physics.tissue import NAME, TissueParameters, floor_place, rest_shape, springs_of
from surg_sim.physics.trocar_motion import MovingPoint


class Bowel:
    """The bowel in a compiled scene, with the parameters that ``add_bowel`` was given."""

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, site: Site, parameters: TissueParameters
    ) -> None:
        self._model, self._data, self._site = model, data, site
        self.parameters = parameters
        n = parameters.nodes
        first = model.joint(f"{NAME}_0_x")
        self._qpos = slice(int(first.qposadr[0]), int(first.qposadr[0]) + 3 * n)
        self._dofs = slice(int(first.dofadr[0]), int(first.dofadr[0]) + 3 * n)
        self._base = rest_shape(site, parameters)
        pairs = springs_of(n)
        tendon = int(model.tendon(f"{NAME}_{pairs[0][1]}_{pairs[0][2]}").id)
        self._tendons = slice(tendon, tendon + len(pairs))
        kinds, self._from, self._to = np.array(pairs).T
        self._stiffness = parameters.springs[kinds]
        # crossing[i, t]: spring t passes the cut between node i and node i + 1.
        cut = np.arange(n - 1)[:, None]
        self._crossing = ((self._from <= cut) & (cut < self._to)).astype(np.float64)
        self._joints = slice(int(first.id), int(first.id) + 3 * n)
        self._mocap = int(model.body(f"{NAME}_floor").mocapid[0])
        self.sites = np.array([model.site(f"{NAME}_{i}").id for i in range(n)])
        """Site of every node, (n,)."""
        self._outer = np.array([model.geom(f"{NAME}_{i}_outer").id for i in range(n)])
        self.inner = np.array([model.geom(f"{NAME}_{i}_inner").id for i in range(n)])
        """Geom of every node that jaw pads meet, (n,); the floor meets the outer ones."""
        self._affinity = np.array(model.geom_conaffinity)
        self.bed = MovingPoint(np.zeros(3))
        """Where what carries the bowel is, relative to its place at rest [m], world."""
        self.reset()

    def reset(self, rng: np.random.Generator | None = None) -> None:
        """At rest in the shape that ``rng`` draws (None: the plain one), held by nobody."""
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
        self._data.mocap_pos[self._mocap] = floor_place(self._site, self.parameters) + self.bed.p_B

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
    def _moved(self) -> Array:
        """Displacement of the nodes from where they rest now [m], (3 n,)."""
        return np.asarray(self._data.qpos[self._qpos] - self._model.qpos_spring[self._qpos])

    @property
    def pulls(self) -> Array:
        """Force of mesentery and anchors on every node [N], world, (n, 3)."""
        return -(self._model.jnt_stiffness[self._joints] * self._moved).reshape(-1, 3)

    @property
    def energy(self) -> float:
        """Elastic and kinetic energy [J]."""
        springs = self._stiffness @ self._stretch() ** 2
        held = self._model.jnt_stiffness[self._joints] @ self._moved**2
        speed, mass = self._data.qvel[self._dofs], self.parameters.mass / self.parameters.nodes
        return float(springs + held + mass * speed @ speed) / 2

    def held_force(self, node: int) -> Array:
        """Force of constraints (a grasp) on a node in the last MuJoCo step [N], world, (3,)."""
        start = self._dofs.start + 3 * node
        return np.array(self._data.qfrc_constraint[start : start + 3])

    def free(self, node: int) -> bool:
        """Whether no tool holds this node."""
        return node not in self._holders

    def hold(self, node: int, tool_bit: int) -> None:
        """A tool holds this node: its jaws no longer push it and its neighbours away.

        ``tool_bit`` is the contact bit of the tool's pads.
        """
        self._holders[node] = tool_bit
        self._set_contacts()

    def release(self, node: int) -> None:
        """The tool that holds this node lets go."""
        del self._holders[node]
        self._set_contacts()

    def _set_contacts(self) -> None:
        """What meets what: a held node nothing, its neighbours not the jaws that hold it."""
        affinity, geoms = self._model.geom_conaffinity, np.append(self._outer, self.inner)
        affinity[geoms] = self._affinity[geoms]
        for node, bit in self._holders.items():
            for beside in range(max(node - 1, 0), min(node + 2, self.parameters.nodes)):
                affinity[self.inner[beside]] &= ~bit
        for node in self._holders:
            affinity[self._outer[node]] = affinity[self.inner[node]] = 0
