"""Leaders: input devices that the teleoperation reads as a stream of samples.

All samples are in the view frame V, the optical axes of the endoscope's left eye: x right, y down,
z away from the viewer. A leader converts its own axes to V; the camera's pose is not its concern. A
leader is one class in one file: bundled, an entry point of the group ``surg_teleop.leaders``, or
the path of a file. A leader that is a process of its own publishes CRTK topics instead
(``leaders/bundled/crtk.py``).
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from surg_core.arm_view import Array
from surg_core.plugins import PluginError, PluginKind

GROUP = "surg_teleop.leaders"
"""Entry points of other packages: ``my_leader = my_package.file:MyLeader``."""

BUTTONS = frozenset(
    {
        "clutch",  # held: the hand moves, the instrument does not
        "camera",  # held: the hand moves the endoscope
        "enable",  # pressed: teleoperation on or off
        "record",  # pressed: recording on or off
        "present",  # held: the operator is there (head sensor, dead-man grip)
        "rate",  # pressed while clutched: the other mapping, of a leader that offers both
        "lock_rotation",  # held: the roll stays
        "lock_translation",  # held: the tip stays
    }
)
"""Names of buttons; a sample holds those that are down."""

_IDENTITY = np.eye(3)
ROTATION_TOLERANCE = 1e-3
"""Largest entry of R R^T - I of a handle's orientation, as left by single precision. A larger one
means a broken driver, and its roll would be wrong."""


class LeaderError(RuntimeError):
    """A leader that cannot be used: what is wrong, with which device, and the cure."""

    def __init__(self, what: str, device: str, cure: str) -> None:
        super().__init__(f"{device}: {what}; {cure}")
        self.what, self.device, self.cure = what, device, cure


@dataclass(frozen=True)
class HandlePose:
    """Pose of the handle in V; only its motion counts, so the origin is arbitrary.

    Attributes:
        p_VH: (3,) handle [m].
        R_VH: (3, 3) its orientation. The third column is the handle axis, about which the hand
            rolls; it points out of the hand, like the instrument.
    """

    p_VH: Array
    R_VH: Array

    def finite(self) -> bool:
        """Whether every number is finite and R_VH is a rotation."""
        return _is_vector(self.p_VH) and _is_rotation(self.R_VH)


@dataclass(frozen=True)
class HandRate:
    """Commanded rate: in the picture, or about the trocar (spherical mode).

    Attributes:
        v_V: (3,) velocity of the tip in V [m/s] at the default scale; other scales change it in
            proportion. Zeros in spherical mode.
        roll: Rate of the shaft's roll [rad/s], positive clockwise seen along the shaft into the
            patient.
        spherical: None, or (3,) rates of yaw, pitch [rad/s] and insertion [m/s] of the virtual
            joints, the paper's spherical mode; v_V is then ignored.
    """

    v_V: Array
    roll: float = 0.0
    spherical: Array | None = None

    def finite(self) -> bool:
        """Whether every number is finite."""
        return (
            _is_vector(self.v_V)
            and math.isfinite(self.roll)
            and (self.spherical is None or _is_vector(self.spherical))
        )


@dataclass(frozen=True)
class LeaderSample:
    """One reading of a leader.

    Attributes:
        stamp: Receipt on the steady clock of ``read``'s ``now`` [s].
        pose: Of the handle; None: the leader has none.
        rate: Commanded velocity; None: the leader has none. A leader may provide both.
        grip: 0 closed to 1 open; None: it has no gripper.
        buttons: Those of BUTTONS that are down.
        problem: Why the leader must not be followed although it sends (for example, its own state
            is not ENABLED), and what to do; empty: it may.
    """

    stamp: float
    pose: HandlePose | None = None
    rate: HandRate | None = None
    grip: float | None = None
    buttons: frozenset[str] = frozenset()
    problem: str = ""

    def finite(self) -> bool:
        """Whether all numbers of the sample are valid."""
        return (
            math.isfinite(self.stamp)
            and (self.pose is None or self.pose.finite())
            and (self.rate is None or self.rate.finite())
            and (self.grip is None or math.isfinite(self.grip))
        )


@runtime_checkable
class Leader(Protocol):
    """An input device; used from one thread only.

    Attributes:
        name: For messages and topics: letters, digits, ``_``.
    """

    name: str

    def open(self) -> None:
        """Open the device.

        Raises:
            LeaderError: It cannot be opened.
        """

    def read(self, now: float) -> LeaderSample | None:
        """The newest sample; never blocks.

        While there is no newer sample, the last one is returned with its old stamp. A device whose
        state holds until it reports a change (a stick at rest) may be stamped ``now``, but only
        while the leader knows that the device is connected.

        Args:
            now: Steady clock [s].

        Returns:
            None: there is no sample yet, or the device is gone.

        Raises:
            LeaderError: The device is lost; ``open`` may be called again.
        """

    def close(self) -> None:
        """Close the device; may be called twice."""


def names() -> tuple[str, ...]:
    """Names that :func:`load` knows: the bundled leaders, then those of installed packages."""
    return KIND.names()


def load(name_or_path: str, settings: Mapping[str, object]) -> Leader:
    """A new leader; its ``open`` has not been called.

    Args:
        name_or_path: Of :func:`names`, or the path of a ``.py`` file that defines one leader. A
            file is executed: load none that you would not run.
        settings: Keyword arguments of its class.

    Raises:
        LeaderError: There is no such leader, the file holds none, or a setting is not allowed.
    """
    try:
        kind = KIND.find(name_or_path)
    except PluginError as error:
        raise LeaderError(error.what, error.where, error.cure) from error
    allowed = [key for key in inspect.signature(kind).parameters if key != "self"]
    unknown = sorted(set(settings) - set(allowed))
    if unknown:
        raise LeaderError(
            f"setting {', '.join(unknown)} is unknown",
            name_or_path,
            f"allowed: {', '.join(allowed) or 'none'}",
        )
    try:
        leader: Leader = kind(**settings)
    except (TypeError, ValueError) as error:
        raise LeaderError(f"{error}", name_or_path, "correct this setting") from error
    return leader


def _is_leader(kind: type) -> bool:
    return (
        not kind.__name__.startswith("_")
        and kind is not Leader
        and all(callable(getattr(kind, method, None)) for method in ("open", "read", "close"))
    )


KIND = PluginKind(
    noun="leader",
    group=GROUP,
    bundled={
        file.stem: f"surg_teleop.leaders.bundled.{file.stem}"
        for file in sorted(Path(__file__).with_name("bundled").glob("*.py"))
        if file.stem[0] != "_"
    },
    accepts=_is_leader,
    shape="one public class with name, open, read and close",
)


def _is_vector(value: Array) -> bool:
    return value.shape == (3,) and math.isfinite(float(value.sum()))


def _is_rotation(value: Array) -> bool:
    if value.shape != (3, 3):
        return False
    defect = float(np.abs(value @ value.T - _IDENTITY).max())
    return defect <= ROTATION_TOLERANCE and bool(np.linalg.det(value) > 0.0)  # False for NaN
