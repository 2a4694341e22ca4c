"""A device on an arm: from the device through the teleoperation to the gate; unplugged, plugged in.

One tick is 2 ms of the arm's clock.
"""

import random
from dataclasses import dataclass, field

import numpy as np
import pytest

from helpers.control.gate_arm import TICK, GateArm
from helpers.teleop.hand import settings
from helpers.teleop.input_devices import GAMEPAD, Machine, Plugged
from surg_teleop.follow.arm_switch import REOPEN, ArmSwitch, Hand
from surg_teleop.follow.teleop_types import CameraView, ControlMode, TeleopOutput, TeleopState
from surg_teleop.follow.teleoperation import Teleop
from surg_teleop.leaders.bundled.gamepad import Gamepad

FULL_SPEED = 0.04  # [m/s] of the gamepad's layout


@dataclass
class Bench:
    """A gamepad in a seat before an arm."""

    machine: Machine = field(default_factory=Machine)
    arm: GateArm = field(default_factory=GateArm)
    pad: Plugged = field(init=False)
    hand: Hand = field(init=False)
    teleop: Teleop = field(init=False)

    def __post_init__(self) -> None:
        self.pad = self.machine.plug(GAMEPAD)
        self.teleop = Teleop(settings(mode=ControlMode.RATE))
        self.hand = Hand(Gamepad(host=self.machine), ArmSwitch(self.teleop))

    def tick(self, n: int = 1) -> TeleopOutput:
        """N cycles."""
        for _ in range(n):
            now = self.arm.tick * TICK
            camera = CameraView(np.eye(3), now)
            sample = self.hand.read(now)
            out = self.hand.switch.tick(now, sample, {"PSM1": self.arm.view()}, camera)["PSM1"]
            self.arm.step(out.commands)
        return out

    def moving(self) -> "Bench":
        """Enabled, dead-man held, left stick half to the right."""
        self.tick(5)
        self.teleop.enable()
        assert self.tick(3).state is TeleopState.FOLLOWING
        self.pad.press("BTN_TR")
        self.pad.push("ABS_X", 1.0)
        self.tick(100)
        assert self.arm.p[0] == pytest.approx(100 * TICK * FULL_SPEED, rel=0.1)
        return self


def test_letting_the_dead_man_go_stops_in_the_same_tick() -> None:
    bench = Bench().moving()
    bench.pad.release("BTN_TR")
    wanted = bench.arm.goal
    bench.tick()
    assert bench.arm.goal is not None
    assert wanted is not None
    assert bench.arm.goal == pytest.approx(wanted, abs=1e-12)


def test_unplugging_stops_in_the_same_tick_and_plugging_in_moves_nothing() -> None:
    bench = Bench().moving()
    bench.machine.unplug(bench.pad)
    out = bench.tick()
    assert out.commands.hold
    assert out.state is TeleopState.WAITING
    assert "'Some Pad' (/dev/input/event7): has gone (No such device)" in bench.hand.problem
    stood = bench.arm.p
    bench.tick(500)

    bench.pad = bench.machine.plug(GAMEPAD)  # with everything held down
    bench.pad.press("BTN_TR")
    bench.pad.push("ABS_X", 1.0)
    bench.tick(round(2 * REOPEN / TICK))
    assert bench.hand.problem == ""
    bench.pad.release("BTN_TR")
    bench.tick(10)
    bench.pad.press("BTN_TR")
    assert bench.tick(5000).state is TeleopState.WAITING
    assert np.array_equal(bench.arm.p, stood)

    bench.pad.push("ABS_X", 0.0)
    bench.teleop.enable()
    assert bench.tick(100).state is TeleopState.FOLLOWING
    assert np.array_equal(bench.arm.p, stood)
    bench.pad.push("ABS_X", 1.0)
    bench.tick(50)
    assert bench.arm.p[0] > stood[0] + 0.001


def test_storms_of_plugging_never_move_an_arm_that_was_not_engaged_anew(
    rng: random.Random, full: bool
) -> None:
    """Motion after a loss only after an act that came later than the device."""
    storms, losses, moved = 500 if full else 6, 0, 0
    for _ in range(storms):
        bench = Bench()
        bench.tick(5)
        engaged_since_plug, there = False, True
        for _ in range(60):
            act = rng.choices(
                ("enable", "clutch", "dead-man", "push", "centre", "plug", "wait"),
                (3, 2, 6, 6, 4, 1, 2),
            )[0]
            if act == "plug" and there:
                bench.machine.unplug(bench.pad)
                there, engaged_since_plug, losses = False, False, losses + 1
            elif act == "plug":
                bench.pad, there = bench.machine.plug(GAMEPAD), True
            elif act == "enable":
                bench.teleop.enable()
                engaged_since_plug = there
            elif there and act == "clutch":
                bench.pad.press("BTN_TL")
                bench.tick(2)
                bench.pad.release("BTN_TL")
                engaged_since_plug = True
            elif there and act == "dead-man":
                bench.pad.press("BTN_TR")
            elif there and act in ("push", "centre"):
                bench.pad.push("ABS_X", 0.9 if act == "push" else 0.0)
            before = bench.arm.p
            bench.tick(rng.choice((1, 20, 120)))
            step = float(np.linalg.norm(bench.arm.p - before))
            if not there:
                assert step <= 2e-3, "the arm went on without its hand"
            elif step > 0:
                moved += 1
                assert engaged_since_plug, "plugging in moved the arm"
        assert bench.arm.refusals == []
    assert losses > storms / 2
    assert moved > storms
    print(f"{storms} storms: {losses} losses, {moved} motions, none without an engagement")
