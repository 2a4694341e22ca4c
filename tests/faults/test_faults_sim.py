"""Faults between the shipped controller and the simulator, in one process: no ROS, no clock."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

import surg_core
from helpers.results.reactions import Reactions
from surg_cli.host import paths
from surg_core import Motion, MotionCommand, Reason, State, StateCommand
from surg_sim.nodes.fault_injector import Injector
from surg_sim.nodes.faults import Fault, Freeze, ToolLost, TrocarJump, Wire
from surg_sim.physics.sim_arm import ArmCommand
from surg_sim.physics.world import World

pytestmark = pytest.mark.untimed

TICK = 0.002
WARM_UP = 150


class Loop:
    """Controller and simulated arm in free-run: what is lost on the way is really gone.

    Args:
        faults: What happens, and when.
        seed: Of the wires.
        track: Whether a tracker tells where the trocar is.
    """

    def __init__(self, *faults: Fault, seed: int = 0, track: bool = False) -> None:
        self.cell = surg_core.load_cell(paths.ROOT / "cells" / "sim_ur5e")
        self.arm = arm = self.cell.arms["PSM1"]
        self.world = World(self.cell)
        self.injector = Injector(self.world, faults, seed, lockstep=False)
        self.track = track
        self.controller = surg_core.Controller(
            arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool, track_rcm=track
        )
        self.controller.set_rcm(arm.trocar.p_BRcm)
        self.newest = (0, self.world.state("PSM1"))
        self.jaw_seen, self.jaw = 0, 0.0
        self.out = self.step()
        assert self.controller.request(StateCommand.ENABLE) == Reason.NONE
        assert self.controller.request(StateCommand.HOME) == Reason.NONE

    @property
    def tick(self) -> int:
        """The present tick."""
        return int(self.world.tick)

    def step(self, *commands: MotionCommand, trocar_sensor: bool = False) -> surg_core.Outputs:
        """One tick of both."""
        now = self.tick
        self.newest = max([self.newest, *self.injector.states("PSM1", now)], key=lambda x: x[0])
        heard, state = self.newest
        jaw = self.injector.jaw("PSM1")
        if jaw is not None:
            self.jaw_seen, self.jaw = now, jaw[0]
        told: dict[str, Any] = {"jaw_age": (now - self.jaw_seen) * TICK}
        if trocar_sensor:
            f = np.asarray(self.world.truth("PSM1").trocar_force)
            told["trocar_force"] = surg_core.ForceSample(-f)  # of the wall on the shaft
        seen = self.injector.track("PSM1", 0) if self.track else None
        if seen is not None:
            told.update(p_BTrack=seen[1], v_BTrack=seen[2])
        self.out = self.controller.step(
            state.q, state.qd, list(commands), jaw=self.jaw, state_age=(now - heard) * TICK,
            readings=surg_core.Readings(**told),
        )  # fmt: skip
        qd = np.array(self.out.qd_command)
        assert np.all(np.isfinite(qd))
        command = ArmCommand(velocity=qd, jaw=self.out.jaw_set)
        self.world.step(self.injector.commands({"PSM1": (now, command)}))
        return self.out

    def aside(self, k: int) -> MotionCommand:
        """The k-th pose of a stream: sideways to and fro, 40 mm/s at most."""
        x = 0.02 * (1 - math.cos(2.0 * k * TICK))
        return MotionCommand(Motion.SERVO_CP, 1, p=[x, 0, 0.1134], rotation=[0, 0, 0, 1])

    def start(self) -> None:
        """Stream until the faults begin."""
        for _ in range(20):
            self.step()
        p = self.controller.X_BR[:3, :3].T @ (self.out.p_set - self.out.p_BRcm)
        self.depth = float(p[2])

    def stream(self, k: int) -> MotionCommand:
        """As ``aside``, at the depth where the arm is."""
        command = self.aside(k)
        p = np.array(command.p)
        p[2] = self.depth
        return MotionCommand(Motion.SERVO_CP, 1, p=p, rotation=[0, 0, 0, 1])

    def speed(self) -> float:
        """Of the true tip [m/s]."""
        return float(np.linalg.norm(self.world.truth("PSM1").tip_velocity))

    def deviation(self) -> float:
        """Of the true shaft from the true trocar [m]."""
        return float(self.world.truth("PSM1").deviation)


@pytest.fixture
def runs(full: bool) -> int:
    """Seeded runs of one row."""
    return 20 if full else 2


LOSSES = {
    "1 % lost": {"loss": 0.01},
    "5 % lost": {"loss": 0.05},
    "bursts of 5": {"loss": 0.02, "burst": 5},
    "5 % doubled, 5 % swapped": {"duplicate": 0.05, "reorder": 0.05},
}


@pytest.mark.parametrize("what", LOSSES)
def test_f11_a_lossy_link_does_not_move_the_pivot(
    runs: int, reactions: Reactions, what: str
) -> None:
    """Both directions of the wire, in free-run, against the simulator's truth."""
    away, lost = [], 0
    for seed in range(runs):
        wires = [
            Wire(arm="PSM1", at=40, topic=topic, **LOSSES[what])
            for topic in ("robot/measured_js", "robot/servo_jv")
        ]
        loop = Loop(*wires, seed=seed)
        loop.start()
        worst = 0.0
        for k in range(400):
            assert loop.step(loop.stream(k)).state == State.ENABLED, loop.out.reason
            worst = max(worst, loop.deviation())
        away.append(1e6 * worst)
        for _, channel in loop.injector._channels.values():
            lost += channel.lost + channel.doubled + channel.swapped
    assert lost > 2 * runs
    name = f"both directions of the robot's wire, {what}"
    reactions.add("F11", name, "true deviation from the trocar", away, 300, "µm")


def test_f10_a_frozen_link_stops_the_arm_by_itself(runs: int, reactions: Reactions) -> None:
    dead, faulted, still = [], [], []
    for seed in range(runs):
        begin = 200 + 7 * seed
        loop = Loop(Freeze(arm="PSM1", at=begin, ticks=300))
        loop.start()
        fault = stopped = rest = 0
        for k in itertools.count():
            loop.step(loop.stream(k))
            if loop.tick == begin:
                assert loop.speed() > 0.005
            if not fault and loop.out.state == State.FAULT:
                assert loop.out.reason == Reason.LINK_LOST
                assert not np.any(loop.out.qd_command)
                fault = loop.tick - 1 - begin + 1
            if not stopped and loop.world.link("PSM1").dead_man:
                stopped = loop.tick - begin
            if stopped and loop.speed() < 1e-3:
                rest = loop.tick - begin
                break
            assert loop.tick < begin + 300
        dead.append(stopped)
        faulted.append(fault)
        still.append(rest)
    reactions.add("F10", "simulated link frozen", "FAULT(link)", faulted, 51)
    reactions.add("F10", "simulated link frozen", "its own dead-man", dead, 21)
    reactions.add("F10", "simulated link frozen", "true tip at rest", still, 21 + 50)


def test_f23_a_trocar_that_jumps_in_the_simulator_faults(runs: int, reactions: Reactions) -> None:
    seen, moved = [], []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        begin = 150 + 11 * seed
        angle = rng.uniform(0, 2 * math.pi)
        loop = Loop(track=True)
        loop.start()
        across = loop.controller.X_BR[:3, :2] @ [math.cos(angle), math.sin(angle)]
        offset = rng.uniform(0.003, 0.009) * across
        loop.injector.add(TrocarJump(arm="PSM1", at=begin, offset=tuple(offset)))
        for k in itertools.count():
            at = loop.tick
            out = loop.step(loop.stream(k))
            if out.state == State.FAULT:
                break
            assert at < begin + 10
        assert out.reason == Reason.RCM_ERROR
        seen.append(at - begin)
        tip = np.array(loop.world.truth("PSM1").tip)
        for _ in range(250):
            loop.step()
        moved.append(1e3 * float(np.linalg.norm(loop.world.truth("PSM1").tip - tip)))
        assert loop.speed() < 1e-3
        assert loop.controller.request(StateCommand.ENABLE) == Reason.RCM_ERROR
    name = "tracked trocar jumps by 3 to 9 mm in the simulator"
    reactions.add("F23", name, "FAULT(rcm_error)", seen, 2)
    # The wall pushes the shaft a little; an arm that ran after the trocar would go millimetres.
    reactions.add("F23", name, "tip after that", moved, 2.0, "mm")


def test_f25_an_untracked_trocar_that_jumps_is_felt(runs: int, reactions: Reactions) -> None:
    """No tracker: the load that the simulator's wall puts on the shaft stops the arm."""
    seen = []
    for seed in range(runs):
        loop = Loop()
        loop.start()
        begin = 150 + 11 * seed
        offset = tuple(0.02 * loop.controller.X_BR[:3, 0])
        loop.injector.add(TrocarJump(arm="PSM1", at=begin, offset=offset))
        above = 0
        for k in itertools.count():
            load = float(np.linalg.norm(loop.world.truth("PSM1").trocar_force))
            out = loop.step(loop.stream(k), trocar_sensor=True)
            above += load > loop.arm.limits.trocar_force_fault
            if out.state == State.FAULT:
                break
            assert loop.tick < begin + 100, f"{load} N"
        assert out.reason == Reason.FORCE
        seen.append(above - 1)
    name = "wall of the simulator loads the shaft with more than 15 N"
    reactions.add("F25", name, "FAULT(force)", seen, 0)


def test_f31_a_lost_tool_link_in_the_simulator_holds_arm_and_jaw(
    runs: int, reactions: Reactions
) -> None:
    said, moved = [], []
    for seed in range(runs):
        begin = 200 + 7 * seed
        loop = Loop(ToolLost(arm="PSM1", at=begin, ticks=400))
        loop.start()
        jaw = math.nan
        for k in range(600):
            commands = [loop.stream(k)]
            if loop.tick == begin - 20:
                commands.append(MotionCommand(Motion.JAW_SERVO_JP, 1, jaw=0.9))
            at = loop.tick
            loop.step(*commands)
            if math.isnan(jaw) and loop.out.reason == Reason.TOOL_LOST:
                said.append(at - begin)
                jaw = loop.out.jaw_set
            elif not math.isnan(jaw):
                moved.append(abs(loop.out.jaw_set - jaw))
        assert loop.out.state == State.ENABLED
        assert loop.speed() < 1e-3, "nothing goes on by itself when the tool is back"
    reactions.add("F31", "simulated tool link lost", "said, arm and jaw hold", said, 101)
    reactions.add("F31", "simulated tool link lost", "jaw moves by", moved, 0.0, "rad")
