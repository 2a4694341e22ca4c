"""Grasping of tissue that can fail: jaws must close on it, and tissue slips when it is pulled.

Each finger has a contact pad. If both pads touch the same piece while the jaws close, a connect
constraint ties the nearest node to the jaws. A pull above the slip force lets the tissue slide to
the neighbouring node on its slack side, and finally out of the jaws. Opening releases it. Jaws that
close on nothing, touch with one pad only, or were closed before contact hold nothing.
"""

from __future__ import annotations

import mujoco
import numpy as np

from surg_core.contract import TICK
from surg_sim.arrays import Array
from surg_sim.physics.bowel import Bowel
from surg_sim.physics.spec_parts import add_pad
from surg_sim.physics.tissue import NAME as BOWEL

GRIP_DEPTH = 0.005
"""Distance of the grip from the tip along the shaft axis [m]."""

_PAD = (0.0018, 0.0009, 0.0075)  # [m] half sizes across, thick, along the finger
_PAD_START = 0.003  # [m] from the pivot to the near end of a pad
CLOSE, OPEN = 0.25, 0.32
"""Jaw angles below which the jaws hold and above which they let go [rad]; assumed, as what follows,
and fixed before any evaluation."""
ATTEMPT = 0.15
"""Time after passing `CLOSE` in which both pads must touch [s]; closed before, they miss."""
REACH = 0.012
"""Largest distance of the grip to the tissue's axis [m]: the jaws must be round it."""
SLIDES = 2
"""How often held tissue slides to a neighbouring place before it is lost."""
REST = 0.10
"""Time after a slide in which the pull is not judged again [s]."""
TEAR = 3.0
"""Pull, as a multiple of the slip force, that takes the tissue out at once."""
SMOOTHING = 0.010
"""Time constant with which the pull is judged [s]."""

_FIRST_BIT = 9
_MOST_TOOLS = 4


def add_grasp(spec: mujoco.MjSpec, name: str, tip: str = "tip") -> None:
    """Add pads, force sensors and the grasp constraint of a tool; call it after ``add_bowel``.

    Bodies and joints of the tool begin with ``<name>_``, its jaw joints are called ``jaw`` and
    ``jaw_mirror``, and ``tip`` is its tip body, z along the shaft, outwards.

    Raises:
        ValueError: The tool has no jaws, or there are too many tools.
    """
    index = sum(equality.name.endswith("_grasp") for equality in spec.equalities)
    if index >= _MOST_TOOLS:
        raise ValueError(f"'{name}' would be tool {index + 1} that grasps; {_MOST_TOOLS} can")
    for side in ("jaw", "jaw_mirror"):
        softness = {"solref": [0.008, 1.0], "solimp": [0.0, 0.9, 0.004, 0.5, 2.0]}  # the tissue's
        bit, middle = 1 << (_FIRST_BIT + index), _PAD_START + _PAD[2]
        add_pad(spec, name, side, _PAD, middle, bit, **softness)
        touch = spec.add_sensor(
            name=f"{name}_{side}_force",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_GEOM,
            objname=f"{name}_{side}_pad",
            datatype=mujoco.mjtDataType.mjDATATYPE_REAL,
        )
        touch.intprm[:3] = [1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3, 1]
    spec.body(f"{name}_{tip}").add_site(
        name=f"{name}_grip", pos=[0.0, 0.0, -GRIP_DEPTH], size=[0.001] * 3, group=4
    )
    spec.add_equality(
        name=f"{name}_grasp",
        type=mujoco.mjtEq.mjEQ_CONNECT,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        name1=f"{name}_grip",
        name2=f"{BOWEL}_0",
        active=False,
        # Draws the tissue into the jaws within a tenth of a second, then holds it.
        solref=[0.03, 1.0],
        solimp=[0.9995, 0.9999, 0.001, 0.5, 2.0],
    )


class Grasp:
    """Grasp of one tool on the bowel in a compiled scene."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, name: str, bowel: Bowel) -> None:
        self._model, self._data, self._bowel = model, data, bowel
        self._jaw = int(model.joint(f"{name}_jaw").qposadr[0])
        self._pads = [int(model.geom(f"{name}_{s}_pad").id) for s in ("jaw", "jaw_mirror")]
        self._bit = int(model.geom_contype[self._pads[0]])
        self._forces = [
            slice(int(s.adr[0]), int(s.adr[0]) + 3)
            for s in (model.sensor(f"{name}_{side}_force") for side in ("jaw", "jaw_mirror"))
        ]
        self._site = int(model.site(f"{name}_grip").id)
        self._equality = int(model.equality(f"{name}_grasp").id)
        self._node_of = {int(geom): i for i, geom in enumerate(bowel.inner)}
        self.held: int | None = None
        self.reset()

    def reset(self) -> None:
        """Hold nothing and clear the counters; the bowel resets itself."""
        self.held = None
        self._data.eq_active[self._equality] = 0
        self._attempt = 0.0  # [s] left in which closing jaws may take hold
        self._smooth = np.zeros(3)
        self._rest = 0.0
        self._slides = 0
        self.slips = 0
        """Number of slides since the reset, including one that lost the tissue."""
        self.losses = 0
        """Number of losses without opening the jaws since the reset."""

    @property
    def jaw(self) -> float:
        """Angle of a finger as it is [rad]."""
        return float(self._data.qpos[self._jaw])

    @property
    def place(self) -> Array:
        """Where the tool holds or would hold, in the world [m], (3,)."""
        return np.array(self._data.site_xpos[self._site])

    @property
    def force(self) -> Array:
        """Force of the tissue on the jaws in the last MuJoCo step [N], world, (3,)."""
        first, second = (self._data.sensordata[part] for part in self._forces)
        return np.asarray(self.pull - first - second)  # the sensors see the jaws' force

    @property
    def pull(self) -> Array:
        """The part of ``force`` that goes through the hold [N], world, (3,)."""
        return np.zeros(3) if self.held is None else -self._bowel.held_force(self.held)

    def touched(self) -> tuple[set[int], set[int]]:
        """Nodes that each of the two pads touches now."""
        nodes: tuple[set[int], set[int]] = (set(), set())
        for a, b in self._data.contact.geom[: self._data.ncon]:
            for pad, touched in zip(self._pads, nodes, strict=True):
                node = self._node_of.get(int(b if pad == a else a))
                if pad in (a, b) and node is not None:
                    touched.add(node)
        return nodes

    def advance(self) -> None:
        """Update the grasp; call it before the physics of each tick."""
        jaw = self.jaw
        if self.held is not None:
            if jaw > OPEN:
                self._release()
            else:
                self._keep()
        elif jaw > CLOSE:
            self._attempt = ATTEMPT
        elif self._attempt > 0.0:
            self._attempt -= TICK
            node = self._between()
            if node is not None:
                self._attempt, self._slides = 0.0, 0
                self._hold(node)

    def _between(self) -> int | None:
        """The free node that both pads touch, or nearly, and that the jaws are round."""
        first, second = self.touched()
        near = [
            i
            for i in first | second
            if self._bowel.free(i) and _beside(i, first) and _beside(i, second)
        ]
        if not near:
            return None
        distance = np.linalg.norm(self._bowel.nodes[near] - self.place, axis=1)
        best = int(np.argmin(distance))
        return near[best] if distance[best] <= REACH else None

    def _hold(self, node: int) -> None:
        self.held = node
        self._bowel.hold(node, self._bit)
        self._model.eq_obj2id[self._equality] = self._bowel.sites[node]
        self._data.eq_active[self._equality] = 1
        self._smooth = np.zeros(3)
        self._rest = REST

    def _release(self) -> None:
        assert self.held is not None
        self._bowel.release(self.held)
        self._data.eq_active[self._equality] = 0
        self.held = None

    def _keep(self) -> None:
        """Hold, slide or lose the tissue, depending on the pull."""
        limit = self._bowel.parameters.slip_force
        self._smooth += (1.0 - np.exp(-TICK / SMOOTHING)) * (self.pull - self._smooth)
        strength = float(np.linalg.norm(self._smooth))
        self._rest = max(0.0, self._rest - TICK)
        if strength <= limit or (self._rest > 0.0 and strength <= TEAR * limit):
            return
        self.slips += 1
        node = self._slack_side()
        self._release()
        if node is None or self._slides >= SLIDES or strength > TEAR * limit:
            self.losses += 1
            return
        self._slides += 1
        self._hold(node)

    def _slack_side(self) -> int | None:
        """The free neighbour that comes between the jaws when the tube slides to its tight side."""
        node = self.held
        assert node is not None
        tensions = self._bowel.tensions
        before = tensions[node - 1] if node > 0 else 0.0
        after = tensions[node] if node < len(tensions) else 0.0
        neighbour = node + 1 if before >= after else node - 1
        inside = 0 <= neighbour <= len(tensions)
        return neighbour if inside and self._bowel.free(neighbour) else None


def _beside(node: int, touched: set[int]) -> bool:
    return any(abs(node - other) <= 1 for other in touched)
