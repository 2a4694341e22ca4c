"""One hand, two arms: an instrument, and the endoscope while the camera pedal is down.

The pedal hands the leader over; the arm that is not held is clutched. Both go through the same
controller and the same :class:`Teleop`, so a hand-over can no more jump than a clutch.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from surg_teleop.follow.arm_view import ArmView
from surg_teleop.follow.teleoperation import CameraView, State, Teleop, TeleopOutput
from surg_teleop.leaders.leader import LeaderSample

PEDAL_SILENCE = 0.25
"""[s] Buttons that are repeated (20 times a second) and have not been for longer are not there."""
PEDAL_REPEATS = 5
"""So many times in a row the same is no accident."""


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

    def means_on(self, buttons: frozenset[str]) -> bool:
        """What the leader's button "enable" means now: off where the hand is on the instrument.

        An instrument that has let go by itself asks for enable, and must get it.

        Args:
            buttons: All that are down.
        """
        state = self.instrument.state
        held = state is State.CLUTCHED and not buttons.isdisjoint(("clutch", "camera"))
        return not (held or state is State.FOLLOWING)

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
    """Pedals and sensors beside the leaders: pressed for every hand, whoever they come from.

    A source that keeps repeating what has not changed lives by it; from then on its silence is
    noticed, as a leader's is. One that speaks only when something changes cannot be watched.
    """

    def __init__(self) -> None:
        self._down: set[tuple[str, str]] = set()
        self._said: dict[tuple[str, str], tuple[bool, float, int]] = {}
        self._heard: dict[str, float] = {}  # of the sources that live by repeating

    def press(self, source: str, button: str, down: bool, now: float) -> bool:
        """A pedal of a source goes down or up; one source does not lift another's foot.

        Args:
            source: Who says so.
            button: One of :data:`~surg_teleop.leaders.leader.BUTTONS`.
            down: Whether it is pressed.
            now: Steady clock [s].

        Returns:
            Whether that is news.
        """
        was, when, repeats = self._said.get((source, button), (None, -math.inf, 0))
        repeats = repeats + 1 if down is was and now - when <= PEDAL_SILENCE else 0
        if source in self._heard or repeats >= PEDAL_REPEATS:
            self._heard[source] = now
        self._said[source, button] = (down, now, repeats)
        if down:
            self._down.add((source, button))
        else:
            self._down.discard((source, button))
        return down is not was

    def problem(self, now: float) -> str:
        """Which source has fallen silent, and the cure; empty: none has."""
        silent = [source for source, heard in self._heard.items() if _silent(now, heard)]
        if not silent:
            return ""
        return (
            f"the buttons of {', '.join(sorted(silent))} are silent: is it running? Start it "
            "again, or press enable to go on without it"
        )

    def forget(self, now: float) -> None:
        """The operator goes on without the sources that are silent; what they held down is up."""
        for source in [s for s, heard in self._heard.items() if _silent(now, heard)]:
            del self._heard[source]
            self._down = {pressed for pressed in self._down if pressed[0] != source}
            self._said = {key: said for key, said in self._said.items() if key[0] != source}

    def merge(self, sample: LeaderSample | None, now: float) -> LeaderSample | None:
        """The sample with the pedals' buttons; it must not be followed while one is silent."""
        if sample is None:
            return None
        if problem := self.problem(now):
            sample = replace(sample, problem=sample.problem or problem)
        if not self._down:
            return sample
        return replace(sample, buttons=sample.buttons | {button for _, button in self._down})


def _silent(now: float, heard: float) -> bool:
    return now - heard > PEDAL_SILENCE
