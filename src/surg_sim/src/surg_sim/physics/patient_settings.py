"""The settings phantom, ex vivo and in vivo: sets of physical parameters, each with its source.

They describe the world, not a result: every value was written down from the literature or assumed
before any RCM deviation in a setting was looked at, and none was changed afterwards; nothing is
tuned to a published figure. docs/reference/simulation.md says where each comes from. The robot is
the same in every setting, and so are its drives and encoders.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import pi, radians
from typing import Any

import numpy as np

from surg_sim.appearance.lens import EndoscopeLens
from surg_sim.arrays import Array
from surg_sim.physics.pose_error import PoseError
from surg_sim.physics.sim_arm import ToolError
from surg_sim.physics.tissue import TissueParameters
from surg_sim.physics.trocar import TrocarParameters
from surg_sim.physics.trocar_motion import Sinusoid


@dataclass(frozen=True)
class Breathing:
    """How the abdomen rises and falls: a sinusoid along the vertical."""

    # Of the wall at the trocar [m], half of peak to peak; 0: it does not breathe.
    amplitude: float = 0.0
    period: float = 4.0  # of one breath [s]
    bed_share: float = 0.5  # share of the amplitude with which what lies in the abdomen moves

    def wall(self, R_WB: Array) -> Sinusoid | None:
        """Motion of a trocar in the axes of its arm's base, R_WB (3, 3) in the world."""
        return self._vertical(self.amplitude, np.asarray(R_WB)[2])

    def bed(self) -> Sinusoid | None:
        """Motion of the tissue bed in the world, for ``Bowel.bed.move``."""
        return self._vertical(self.amplitude * self.bed_share, np.array([0.0, 0.0, 1.0]))

    def _vertical(self, amplitude: float, up: Array) -> Sinusoid | None:
        if amplitude == 0.0:
            return None
        x, y, z = (float(v) for v in up)
        return Sinusoid(amplitude, 1.0 / self.period, (x, y, z))


@dataclass(frozen=True)
class PatientSetting:
    """One setting."""

    name: str
    trocar: TrocarParameters = field(default_factory=TrocarParameters)
    breathing: Breathing = field(default_factory=Breathing)
    tool_error: ToolError | None = None  # how wrong the instrument's calibration is; None: exact
    # How wrong the registrations of a cell are that nobody has measured; None: exact.
    base_error: PoseError | None = None  # of every base but the first arm's
    camera_error: PoseError | None = None  # of the left camera in the flange that holds it
    # Of each eye of the endoscope; default: a pinhole.
    lens: EndoscopeLens = field(default_factory=EndoscopeLens)
    encoder: float = 0.0  # smallest joint angle that the robot reports [rad]; 0: exact
    tissue: TissueParameters = field(default_factory=TissueParameters)


_ENCODER = 2.0 * pi / 2**19

SETTINGS: Mapping[str, PatientSetting] = {
    "phantom": PatientSetting(
        name="phantom",
        trocar=TrocarParameters(stiffness=1500.0, friction=0.5),
        tool_error=ToolError(tip=0.0001, axis=radians(0.07)),
        encoder=_ENCODER,
        tissue=TissueParameters(stretch=21.0, slip_force=3.0),
    ),
    "ex_vivo": PatientSetting(
        name="ex_vivo",
        trocar=TrocarParameters(stiffness=800.0, friction=1.0),
        tool_error=ToolError(tip=0.0002, axis=radians(0.14)),
        encoder=_ENCODER,
        tissue=TissueParameters(stretch=33.0, slip_force=2.0),
    ),
    "in_vivo": PatientSetting(
        name="in_vivo",
        trocar=TrocarParameters(stiffness=800.0, friction=1.5),
        breathing=Breathing(amplitude=0.002),
        tool_error=ToolError(tip=0.0003, axis=radians(0.21)),
        encoder=_ENCODER,
        tissue=TissueParameters(stretch=33.0, slip_force=2.0),
    ),
}

VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "unregistered": {
        "base_error": PoseError(shift=0.008, turn=radians(2.0)),
        "camera_error": PoseError(shift=0.005, turn=radians(4.0)),
    },
    "reclamped": {
        "camera_error": PoseError(shift=0.005, turn=radians(16.0)),
    },
    "lens": {
        "lens": EndoscopeLens(
            distortion=(-0.3, 0.08, 0.0005, -0.0005, 0.0),
            zoom=1.01,
            centre=(0.01, -0.008),
            edge=0.4,
        ),
    },
}
"""What a setting can have besides, as in ``phantom+unregistered``; assumed: bases typed from a
drawing, an endoscope clamped by hand. ``reclamped`` turns the latter by a further 12 degrees."""


def find_setting(name: str) -> PatientSetting:
    """The setting of this name, with its variants: ``in_vivo``, ``phantom+unregistered``.

    Raises:
        ValueError: There is none; the message lists what exists.
    """
    base, *variants = name.split("+")
    if base not in SETTINGS:
        raise ValueError(f"no setting '{base}': there are {', '.join(SETTINGS)}")
    found = SETTINGS[base]
    for variant in variants:
        if variant not in VARIANTS:
            raise ValueError(
                f"setting '{name}': no variant '{variant}': there are {', '.join(VARIANTS)}"
            )
        found = replace(found, name=name, **VARIANTS[variant])
    return found
