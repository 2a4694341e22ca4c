"""Leaders: input devices that the teleoperation reads as a stream of samples.

All samples are in the view frame V, the optical axes of the endoscope's left eye: x right, y down,
z away from the viewer. A leader converts its own axes to V; the camera's pose is not its concern. A
leader is one class in one file: bundled, an entry point of the group ``surg_teleop.leaders``, or
the path of a file. A leader that is a process of its own publishes CRTK topics instead
(``leaders/bundled/crtk.py``).
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol, runtime_checkable

from surg_core.hand.leader_sample import LeaderSample
from surg_core.plugins import PluginError, PluginKind

GROUP = "surg_teleop.leaders"
"""Entry points of other packages: ``my_leader = my_package.file:MyLeader``."""


class LeaderError(RuntimeError):
    """A leader that cannot be used: what is wrong, with which device, and the cure."""

    def __init__(self, what: str, device: str, cure: str) -> None:
        super().__init__(f"{device}: {what}; {cure}")
        self.what, self.device, self.cure = what, device, cure


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
