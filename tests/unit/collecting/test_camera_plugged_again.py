"""A camera is unplugged and plugged in again while the tip follows a hand: nothing moves by itself.

The capture process's own stream, from a scripted device, is the picture before the operator.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import metadata
from types import SimpleNamespace

import numpy as np
import pytest

from surg_console.session.console_orders import EnableTeleop, Move, SetOperatorPresent
from surg_console.session.console_session import FROZEN, ConsoleSession, Phase
from surg_console.session.system_state import Arm, Follower, Robot
from surg_console.web.page_protocol import Input
from surg_perception.capture.capture_parameters import CaptureSettings
from surg_perception.capture.device_process import messages
from surg_perception.capture.frame_pipe import DeviceState, Pictures
from surg_perception.capture.picture_source import Grabbed, PictureSource, SourceError, Wanted

TICK, PERIOD = 0.01, 0.05
BEFORE, GONE, AFTER = 20, 4, 60
"""Pictures before, attempts to open it in vain, pictures after."""


class Plugged(PictureSource):
    """A device that disappears once."""

    count = 0

    def __init__(self, address: str, options: Mapping[str, str], wanted: Wanted) -> None:
        super().__init__(address, options, wanted)
        if BEFORE <= Plugged.count < BEFORE + GONE:
            Plugged.count += 1
            raise SourceError("no_device", "absent")

    def pictures(self) -> Iterator[Grabbed]:
        while True:
            Plugged.count += 1
            if Plugged.count == BEFORE:
                raise SourceError("gone", "unplugged")
            rng = np.random.default_rng(Plugged.count)
            picture = rng.integers(40, 200, (48, 64, 3)).astype(np.uint8)
            stamp = Plugged.count * round(1e9 * PERIOD)
            yield Grabbed(stamp, stamp, (picture,))


class Hand:
    """An operator whose hand never rests, on a fake clock; the arm follows as it is told."""

    def __init__(self) -> None:
        self.session = ConsoleSession(True)
        self.robot = Robot((Arm("PSM1", "ENABLED", True, 1e9),), Follower("DISABLED"))
        self.now, self.picture_us, self.seq = 0.0, 0, 0
        self.moves: list[float] = []
        self.last: dict[type, bool] = {}
        self.session.join("a", self.now)

    def live(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK)):
            self.now, self.seq = self.now + TICK, self.seq + 1
            sample = Input(self.seq, self.now, picture_us=self.picture_us, v=(0.01, 0.0, 0.0))
            self.session.receive("a", sample, self.now)
            self.session.tick(self.robot, self.now)
            self.obey()

    def obey(self) -> None:
        for order in self.session.take_orders():
            if isinstance(order, Move):
                self.moves.append(self.now)
            elif isinstance(order, SetOperatorPresent | EnableTeleop):
                self.last[type(order)] = bool(order.value)
            if isinstance(order, EnableTeleop):
                state = "FOLLOWING" if order.value else "DISABLED"
                self.robot = Robot(self.robot.arms, Follower(state))


def test_nothing_moves_until_the_operator_enables_again(monkeypatch: pytest.MonkeyPatch) -> None:
    Plugged.count = 0
    point = SimpleNamespace(name="plugged", value="tests:Plugged", load=lambda: Plugged)
    monkeypatch.setattr(metadata, "entry_points", lambda group: [point])
    hand, told = Hand(), []
    wanted = Wanted(lambda: 0, hand.live)  # while the process waits, the hand goes on
    for message in messages(CaptureSettings(source="plugged:0", layout="mono", eyes=1), wanted):
        if isinstance(message, DeviceState):
            told.append((message.code, hand.now))
        elif isinstance(message, Pictures):
            hand.picture_us = message.stamp_ns // 1000
        hand.live(PERIOD)
        if Plugged.count == 5:
            assert hand.session.enable("a", hand.robot, hand.now) == ""
            hand.obey()
        if Plugged.count >= BEFORE + GONE + AFTER:
            break
    codes, (lost, back) = [code for code, _ in told], (told[1][1], told[-1][1])
    print(f"told {codes}; gone {lost:.2f} s, back {back:.2f} s, moved until {hand.moves[-1]:.2f} s")
    assert codes == ["open", "gone", "no_device", "open"]
    assert hand.moves[0] < lost, "the tip followed"
    assert hand.moves[-1] <= lost + FROZEN + 2 * PERIOD < back < hand.now - 1.0
    assert hand.last == {SetOperatorPresent: False, EnableTeleop: False}
    assert hand.session.phase is Phase.HELD
