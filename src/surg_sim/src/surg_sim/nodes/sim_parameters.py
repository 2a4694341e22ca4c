"""Parameters of the simulator's nodes. No ROS."""

from __future__ import annotations

from dataclasses import dataclass

from surg_ros.params import ParamError, flag, names, one_of, real, text, whole
from surg_sim.nodes.lockstep import OBSERVER_WINDOWS

MODES = ("lockstep", "freerun")
VIEWS = (("left",), ("left", "right"))
"""Sets of views that an endoscope can render."""
DEFAULT_SETTING = "phantom"
"""Physical setting of a task for which none is given."""
_SEEDS = 2**31 - 1


@dataclass(frozen=True)
class BridgeSettings:
    """Parameters of the node ``/sim``."""

    cell: str = text()
    mode: str = one_of(MODES, "lockstep")
    participants: tuple[str, ...] = names(())  # declared commanders, waited for in every tick
    observers: tuple[str, ...] = names((), options=tuple(OBSERVER_WINDOWS))
    arms: tuple[str, ...] = names(())  # arms to simulate; empty: all of the cell
    seed: int = whole(0, _SEEDS, 0)
    # The simulator tracks the trocars and publishes ``rcm/track``, this old [s]; -1: it does not.
    # In lock-step the controller must have ``sim`` among its participants.
    track_stale: float = real(-1.0, 1.0, -1.0)
    task: str = text("", empty=True)  # name or file of the task that is played; empty: none
    setting: str = text("", empty=True)  # empty: the simulator's own parameters
    # Free-run: the phantom goes on when its task is over, for people who try again.
    endless: bool = flag(False)
    faults: str = text("", empty=True)  # from the start, as JSON (``faults``)
    inject: bool = flag(False)  # take further faults on ``/sim/inject``
    # In lock-step, longest wait for everybody to connect, and for the answer to a tick [s].
    connect_timeout: float = real(1.0, 3600.0, 60.0)
    abort_timeout: float = real(1.0, 600.0, 10.0)

    def __post_init__(self) -> None:
        """Gives a task without a setting the default one."""
        object.__setattr__(self, "setting", _setting(self.task, self.setting))


@dataclass(frozen=True)
class EndoscopeSettings:
    """Parameters of the node ``/endoscope``; cell, arms, task and setting are the bridge's."""

    cell: str = text()
    # ``lockstep`` (every snapshot) or ``freerun`` (the newest one only).
    mode: str = one_of(MODES, "lockstep")
    arms: tuple[str, ...] = names(())
    seed: int = whole(0, _SEEDS, 0)  # the bridge's: it draws the tissue
    task: str = text("", empty=True)
    setting: str = text("", empty=True)
    views: tuple[str, ...] = names(("left",))  # which of ``left`` and ``right`` are rendered
    width: int = whole(16, 1920, 640)  # [px]
    height: int = whole(16, 1080, 480)  # [px]
    vignette: bool = flag(True)  # draw the round edge of an endoscope's picture

    def __post_init__(self) -> None:
        """Gives a task without a setting the default one.

        Raises:
            ParamError: There are no such views.
        """
        if self.views not in VIEWS:
            raise ParamError("views", list(self.views), " or ".join(map(",".join, VIEWS)))
        object.__setattr__(self, "setting", _setting(self.task, self.setting))


@dataclass(frozen=True)
class SenderSettings:
    """Parameters of a scripted sender."""

    cell: str = text()  # path of the cell, the same as the bridge's
    task: str = text()
    seed: int = whole(0, _SEEDS, 0)  # of the sender's imperfections
    # In real time: arms that must have been ENABLED before the sender begins.
    after: tuple[str, ...] = names(())


def _setting(task: str, setting: str) -> str:
    return setting or (DEFAULT_SETTING if task else "")
