"""A leader and its arms: an instrument, and the endoscope while the camera pedal is down.

The arm that the leader does not drive is clutched. Both arms go through the same :class:`Teleop`
and the same controller, so switching arms cannot jump any more than a clutch can.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from surg_core.arm_view import ArmView
from surg_core.hand.leader_sample import LeaderSample
from surg_teleop.follow.teleop_types import CameraView, TeleopOutput, TeleopState
from surg_teleop.follow.teleoperation import Teleop
from surg_teleop.leaders.leader import Leader, LeaderError

REOPEN = 1.0
"""[s] Interval between attempts to open a lost device."""


@dataclass
class ArmSwitch:
    """The arms that one leader drives."""

    instrument: Teleop  # driven by default
    # driven while the camera pedal is down; None: the pedal only clutches
    endoscope: Teleop | None = None

    @property
    def arms(self) -> dict[str, Teleop]:
        """Both, by the arm's name."""
        both = (self.instrument, self.endoscope)
        return {teleop.settings.arm: teleop for teleop in both if teleop is not None}

    def enable(self) -> None:
        """Enable all arms."""
        for teleop in self.arms.values():
            teleop.enable()

    def disable(self) -> None:
        """Disable all arms."""
        for teleop in self.arms.values():
            teleop.disable()

    def enables(self, buttons: frozenset[str]) -> bool:
        """Whether the leader's button "enable" now means on rather than off; `buttons`: all down.

        It means off while the leader drives the instrument. An instrument that has let go by
        itself asks for enable, so it means on then.
        """
        state = self.instrument.state
        clutched = state is TeleopState.CLUTCHED and not buttons.isdisjoint(("clutch", "camera"))
        return not (clutched or state is TeleopState.FOLLOWING)

    def tick(
        self,
        now: float,
        sample: LeaderSample | None,
        views: Mapping[str, ArmView],
        camera: CameraView | None,
    ) -> dict[str, TeleopOutput]:
        """Evaluate both arms once; arguments as of :meth:`Teleop.tick`, arms by name.

        The endoscope may be driven after the camera has moved: its motion shows what moved.
        """
        pedal = sample is not None and "camera" in sample.buttons
        outputs = {}
        for name, teleop in self.arms.items():
            driven = pedal if teleop is self.endoscope else not pedal
            arm_sample = sample if driven else _clutched(sample)
            view = camera
            if camera is not None and teleop is self.endoscope:
                view = replace(camera, moved="")
            outputs[name] = teleop.tick(now, arm_sample, views.get(name), view)
        return outputs


@dataclass
class Hand:
    """A leader and the arms that it drives."""

    leader: Leader
    switch: ArmSwitch
    problem: str = "it has not been opened yet"  # why the leader cannot be read; empty if it can
    retry: float = -math.inf  # time of the next attempt to open it [s]
    buttons: frozenset[str] = frozenset()

    def read(self, now: float) -> LeaderSample | None:
        """The newest sample; a lost device is reopened periodically."""
        try:
            if self.problem:
                if now < self.retry:
                    return None
                self.leader.open()
                self.problem = ""
            return self.leader.read(now)
        except Exception as error:
            # A user's leader may raise anything; its arm must be let go all the same.
            known = isinstance(error, LeaderError)
            self.problem = str(error) if known else f"{type(error).__name__}: {error}"
            self.retry = now + REOPEN
            with contextlib.suppress(Exception):
                self.leader.close()
            return None

    def pressed(self, sample: LeaderSample | None) -> frozenset[str]:
        """Buttons that have just gone down."""
        now = sample.buttons if sample is not None else self.buttons
        new, self.buttons = now - self.buttons, now
        return new


def _clutched(sample: LeaderSample | None) -> LeaderSample | None:
    return None if sample is None else replace(sample, buttons=sample.buttons | {"clutch"})
