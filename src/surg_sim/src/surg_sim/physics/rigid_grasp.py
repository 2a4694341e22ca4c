"""Grasping rigid things: jaws that close with both pads on one object hold it until they open.

The object is welded to the instrument as it lay between the pads, and lost when it is pulled or
twisted off. Bowel is held in another way (``grasp``): it gives, and it slips.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from surg_sim.physics.spec_parts import add_pad
from surg_sim.physics.tissue_grasp import CLOSE, OPEN

PAD_BIT = 1 << 16
"""Contact bit of the pads."""
GRIP_DEPTH = 0.002
"""Where an object is best held: this far behind the tip on the shaft axis [m]."""

_JAWS = ("jaw", "jaw_mirror")
_PAD = (0.0016, 0.0008, 0.0070)  # [m] half sizes across, thick, along the finger
_PAD_MIDDLE = 0.0105  # [m] from the pivot


def add_rigid_grasp(spec: mujoco.MjSpec, name: str, tip: str, objects: Sequence[str]) -> None:
    """Give a jawed tool pads, and one hold per body that it can hold; switches contacts on.

    Bodies and joints of the tool begin with ``<name>_``; ``tip`` is its tip without the prefix.

    Raises:
        ValueError: The tool has no jaws.
    """
    spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for side in _JAWS:
        softness = {"solref": [0.02, 1.0], "solimp": [0.0, 0.9, 0.002, 0.5, 2.0]}
        add_pad(spec, name, side, _PAD, _PAD_MIDDLE, PAD_BIT, **softness)
    for target in objects:
        spec.add_equality(
            name=f"{name}_holds_{target}",
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1=f"{name}_{tip}",
            name2=target,
            active=False,
            solref=[0.006, 1.0],
        )


class RigidGrasp:
    """The hold of one jawed tool on rigid objects in a compiled scene; see ``add_rigid_grasp``."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        name: str,
        tip: str,
        objects: Sequence[str],
    ) -> None:
        self._model, self._data = model, data
        self._jaw = int(model.joint(f"{name}_jaw").qposadr[0])
        self._tip = int(model.body(f"{name}_{tip}").id)
        self._pads = [int(model.geom(f"{name}_{side}_pad").id) for side in _JAWS]
        self._bodies = {target: int(model.body(target).id) for target in objects}
        self._welds = {t: int(model.equality(f"{name}_holds_{t}").id) for t in objects}
        self.held: str | None = None
        self.reset()

    def reset(self) -> None:
        """Nothing held."""
        self._let_go()
        self._armed = False

    @property
    def jaw(self) -> float:
        """Angle of a finger as it is [rad]."""
        return float(self._data.qpos[self._jaw])

    def advance(self) -> None:
        """Take, keep or release; called before the physics of each tick."""
        if self.held is not None:
            if self.jaw > OPEN:
                self._let_go()
        elif self.jaw > CLOSE:
            self._armed = True
        elif self._armed:
            both = self._touched(self._pads[0]) & self._touched(self._pads[1])
            if both:
                self._take(min(both))

    def _touched(self, pad: int) -> set[str]:
        pairs = self._data.contact.geom[: self._data.ncon]
        others = [int(b if a == pad else a) for a, b in pairs if pad in (a, b)]
        bodies = {int(self._model.geom_bodyid[geom]) for geom in others}
        return {target for target, body in self._bodies.items() if body in bodies}

    def _take(self, target: str) -> None:
        """Weld it as it lies: the object's pose in the tip's frame becomes the weld's."""
        data, body = self._data, self._bodies[target]
        R = data.xmat[self._tip].reshape(3, 3)
        position = R.T @ (data.xpos[body] - data.xpos[self._tip])
        back, turn = np.empty(4), np.empty(4)
        mujoco.mju_negQuat(back, data.xquat[self._tip])
        mujoco.mju_mulQuat(turn, back, data.xquat[body])
        # anchor in the object's frame (its origin), pose of the object in the tip's, torque scale
        self._model.eq_data[self._welds[target], :11] = [0, 0, 0, *position, *turn, 0.02]
        data.eq_active[self._welds[target]] = 1
        self._pads_touch(target, False)
        self.held, self._armed = target, False

    def _let_go(self) -> None:
        for target, weld in self._welds.items():
            self._data.eq_active[weld] = 0
            self._pads_touch(target, True)
        self.held = None

    def _pads_touch(self, target: str, yes: bool) -> None:
        """Whether the pads push this object: not while they hold it."""
        body = self._bodies[target]
        first = int(self._model.body_geomadr[body])
        for geom in range(first, first + int(self._model.body_geomnum[body])):
            if yes:
                self._model.geom_conaffinity[geom] |= PAD_BIT
            else:
                self._model.geom_conaffinity[geom] &= ~PAD_BIT
