"""One leader, two arms: an instrument, and the endoscope while the camera pedal is down.

The arm that the leader does not drive is clutched. Both arms go through the same :class:`Teleop`
and the same controller, so switching arms cannot jump any more than a clutch can.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from surg_core.arm_view import ArmView
from surg_core.hand.leader_sample import LeaderSample
from surg_teleop.follow.teleop_types import CameraView, TeleopOutput, TeleopState
from surg_teleop.follow.teleoperation import Teleop


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


def _clutched(sample: LeaderSample | None) -> LeaderSample | None:
    return None if sample is None else replace(sample, buttons=sample.buttons | {"clutch"})
