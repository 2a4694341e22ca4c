"""Pedals and buttons: hand-over, enable, and pedals that fall silent."""

import numpy as np
import pytest

from helpers.control.gate_arm import TICK, GateArm
from helpers.teleop.hand import Hand, settings
from surg_core.arm_view import ArmState
from surg_core.contract import PRESENCE_TIMEOUT
from surg_teleop.follow.arm_switch import ArmSwitch
from surg_teleop.follow.pedal_monitor import PedalMonitor
from surg_teleop.follow.teleop_types import CameraView, TeleopState
from surg_teleop.follow.teleoperation import Teleop


def test_the_camera_pedal_hands_the_leader_over_and_back() -> None:
    hand, psm, ecm = Hand(), GateArm(), GateArm(p=np.array([0.0, 0.01, 0.06]))
    seat = ArmSwitch(
        Teleop(settings(), scale=1.0), Teleop(settings(arm="ECM", jaw=None), scale=1.0)
    )
    pedals = PedalMonitor()
    moved = ""
    seat.enable()

    def run(n: int, step: float) -> dict[str, TeleopState]:
        for _ in range(n):
            now = psm.tick * TICK
            hand.move(np.array([step, 0.0, 0.0]))
            sample = pedals.merge(hand.sample(now), now)
            views = {"PSM1": psm.view(), "ECM": ecm.view()}
            outputs = seat.tick(now, sample, views, CameraView(np.eye(3), moved=moved))
            psm.step(outputs["PSM1"].commands)
            ecm.step(outputs["ECM"].commands)
        return {arm: out.state for arm, out in outputs.items()}

    assert run(10, 1e-4) == {"PSM1": TeleopState.FOLLOWING, "ECM": TeleopState.CLUTCHED}
    pedals.press("/console", "camera", True, psm.tick * TICK)
    pedals.press("/footpedals", "camera", True, psm.tick * TICK)
    p_psm, p_ecm = psm.p, ecm.p
    assert run(100, 1e-4) == {"PSM1": TeleopState.CLUTCHED, "ECM": TeleopState.FOLLOWING}
    assert np.linalg.norm(psm.p - p_psm) < 1e-3
    assert (ecm.p - p_ecm)[0] == pytest.approx(0.01, abs=5e-4)
    pedals.press("/console", "camera", False, psm.tick * TICK)
    assert run(10, 0.0)["ECM"] is TeleopState.FOLLOWING  # the other foot is still down
    pedals.press("/footpedals", "camera", False, psm.tick * TICK)
    assert run(100, 0.0) == {"PSM1": TeleopState.FOLLOWING, "ECM": TeleopState.CLUTCHED}
    moved = "the picture is not what was calibrated"
    pedals.press("/console", "camera", True, psm.tick * TICK)
    assert run(100, 0.0)["ECM"] is TeleopState.FOLLOWING, "its motion shows what moved"
    pedals.press("/console", "camera", False, psm.tick * TICK)
    assert run(100, 0.0)["PSM1"] is TeleopState.CLUTCHED
    assert psm.refusals == ecm.refusals == []


def test_the_button_enable_ends_only_what_the_hand_is_on() -> None:
    """What says "press enable" can be obeyed with the device itself."""
    hand, arm, seat = Hand(), GateArm(), ArmSwitch(Teleop(settings()))

    def run(state: TeleopState, n: int = 100) -> bool:
        for _ in range(n):
            now = arm.tick * TICK
            out = seat.tick(now, hand.sample(now), {"PSM1": arm.view()}, CameraView(np.eye(3)))
            arm.step(out["PSM1"].commands)
        assert out["PSM1"].state is state, out["PSM1"].message
        return seat.enables(frozenset(hand.buttons | {"enable"}))

    assert run(TeleopState.DISABLED)
    seat.enable()
    assert not run(TeleopState.FOLLOWING)
    hand.buttons = {"clutch"}
    assert not run(TeleopState.CLUTCHED)
    hand.buttons = {"camera"}  # nobody holds the endoscope: it clutches
    assert not run(TeleopState.CLUTCHED)
    seat.enable()
    hand.buttons = set()
    assert not run(TeleopState.FOLLOWING)
    hand.move(np.array([0.5, 0.0, 0.0]))
    assert run(TeleopState.CLUTCHED)  # let go: "press and release the clutch, or press enable"
    for state, left in (
        (TeleopState.WAITING, ArmState.PAUSED),
        (TeleopState.FAULT, ArmState.FAULT),
    ):
        arm.leave(left, "force")
        assert run(state)


class Floor:
    """A pedal node that repeats what is down 20 times a second, before a hand on an arm."""

    def __init__(self) -> None:
        self.hand, self.arm, self.pedals = Hand(), GateArm(), PedalMonitor()
        self.teleop = Teleop(settings(), scale=1.0)
        self.down, self.speaks, self.sent = False, True, 0

    def run(self, ticks: int) -> TeleopState:
        """Moves the hand on for so many ticks; the state at the end."""
        for _ in range(ticks):
            now = self.arm.tick * TICK
            if self.speaks and self.arm.tick % 25 == 0:
                self.pedals.press("/pedals", "clutch", self.down, now)
            self.hand.move(np.array([1e-4, 0.0, 0.0]))
            sample = self.pedals.merge(self.hand.sample(now), now)
            self.out = self.teleop.tick(now, sample, self.arm.view(), CameraView(np.eye(3)))
            self.sent += self.out.commands.servo_cp is not None
            self.arm.step(self.out.commands)
        return self.out.state

    def ticks_to(self, state: TeleopState, at_most: int = 2000) -> int:
        return next(i + 1 for i in range(at_most) if self.run(1) is state)


def test_f03_pedals_that_are_killed_hold_the_arm_within_their_limit() -> None:
    floor = Floor()
    floor.teleop.enable()
    assert floor.run(500) is TeleopState.FOLLOWING
    floor.speaks = False  # kill -9 with the clutch up
    last = (floor.arm.tick - 1) // 25 * 25
    floor.ticks_to(TeleopState.WAITING)
    # The first tick later than the limit after the last word.
    assert floor.arm.tick - 1 - last == round(PRESENCE_TIMEOUT / TICK) + 1
    assert "the buttons of /pedals are silent" in floor.out.message
    rest, sent = floor.arm.p, floor.sent
    assert floor.run(1000) is TeleopState.WAITING
    assert floor.sent == sent and np.linalg.norm(floor.arm.p - rest) < 1e-3
    # They are back, with the clutch let go meanwhile: that is no act.
    floor.speaks = True
    assert floor.run(1000) is TeleopState.WAITING and floor.sent == sent
    assert "press and release the clutch, or press enable" in floor.out.message
    floor.down = True
    floor.ticks_to(TeleopState.CLUTCHED)
    floor.down = False
    floor.ticks_to(TeleopState.FOLLOWING)
    assert floor.arm.refusals == []


def test_f03_pedals_killed_with_the_clutch_down_engage_nothing_when_they_come_back_up() -> None:
    floor = Floor()
    floor.teleop.enable()
    floor.run(500)
    floor.down = True
    floor.ticks_to(TeleopState.CLUTCHED)
    floor.run(200)
    floor.speaks = False
    floor.ticks_to(TeleopState.WAITING)
    floor.down, floor.speaks = False, True
    assert floor.run(1000) is TeleopState.WAITING


def test_enable_goes_on_without_pedals_that_are_silent() -> None:
    floor = Floor()
    floor.down = True
    floor.run(500)
    floor.speaks = False
    floor.run(500)
    floor.pedals.forget(floor.arm.tick * TICK)
    floor.teleop.enable()
    assert floor.run(500) is TeleopState.FOLLOWING  # what they held down is up
    floor.speaks = True
    floor.ticks_to(TeleopState.CLUTCHED)  # their foot is on it again


def test_a_pedal_that_speaks_on_change_alone_is_not_watched() -> None:
    pedals, hand = PedalMonitor(), Hand()
    for k in range(4):  # a change, and the same again three times, as a driver may do
        pedals.press("/dvrk", "clutch", True, 0.1 * k)
    pedals.press("/dvrk", "clutch", False, 5.0)
    assert pedals.problem(60.0) == ""
    assert pedals.merge(hand.sample(60.0), 60.0).problem == ""
