"""One hand, two arms: an instrument, and the endoscope while the camera pedal is down.

The pedal hands the leader over; the arm that is not held is clutched. Both go through the same
controller and the same :class:`Teleop`, so a hand-over can no more jump than a clutch.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from surg_teleop.arm import ArmView
from surg_teleop.leader import LeaderSample
from surg_teleop.teleop import CameraView, Teleop, TeleopOutput


@dataclass
class Seat:
    """A leader and the arms that it may hold.

    Attributes:
        instrument: What the hand holds.
        endoscope: What it holds while the camera pedal is down; None: the pedal only clutches.
    """

    instrument: Teleop
    endoscope: Teleop | None = None

    @property
    def arms(self) -> dict[str, Teleop]:
        """Who follows the hand, by the arm's name."""
        both = (self.instrument, self.endoscope)
        return {one.settings.arm: one for one in both if one is not None}

    def enable(self) -> None:
        """The operator takes the seat."""
        for one in self.arms.values():
            one.enable()

    def disable(self) -> None:
        """The operator leaves it."""
        for one in self.arms.values():
            one.disable()

    def tick(
        self,
        now: float,
        sample: LeaderSample | None,
        views: Mapping[str, ArmView],
        camera: CameraView | None,
    ) -> dict[str, TeleopOutput]:
        """Looks at everything once; arguments as :meth:`Teleop.tick`, arms by name."""
        pressed = sample is not None and "camera" in sample.buttons
        outputs = {}
        for name, one in self.arms.items():
            held = pressed if one is self.endoscope else not pressed
            outputs[name] = one.tick(now, _clutched(sample, not held), views.get(name), camera)
        return outputs


def _clutched(sample: LeaderSample | None, clutched: bool) -> LeaderSample | None:
    if sample is None or not clutched:
        return sample
    return replace(sample, buttons=sample.buttons | {"clutch"})


class Pedals:
    """Pedals and sensors beside the leaders: pressed for every hand, whoever they come from."""

    def __init__(self) -> None:
        self._down: set[tuple[str, str]] = set()

    def press(self, source: str, button: str, down: bool) -> None:
        """A pedal of a source goes down or up; one source does not lift another's foot."""
        if down:
            self._down.add((source, button))
        else:
            self._down.discard((source, button))

    def merge(self, sample: LeaderSample | None) -> LeaderSample | None:
        """The sample with the pedals' buttons."""
        if sample is None or not self._down:
            return sample
        return replace(sample, buttons=sample.buttons | {button for _, button in self._down})
