"""F33: the simulated robot stops by itself, and says so; judged by the simulator's truth."""

from __future__ import annotations

import math

import numpy as np
import pytest

import surg_core
from helpers.results.reactions import Reactions
from surg_cli.host import paths
from surg_core import Law, Motion, MotionCommand, Reason, RobotCondition, State, StateCommand
from surg_sim.nodes.fault_injector import Injector
from surg_sim.nodes.faults import CONDITIONS, RobotStop
from surg_sim.physics.sim_arm import ArmCommand
from surg_sim.physics.world import World

pytestmark = pytest.mark.untimed

HALTS = tuple(name for name in CONDITIONS if name not in ("offline", "slowed"))
SPEEDS = {"scale 1": 0.012, "scale 0.1": 0.0012}
"""[m/s] Of the tip: the bundled motion at the stop, and a tenth of it."""


class Loop:
    """Controller and simulated robot in lock-step; the condition belongs to the tick."""

    def __init__(self, stop: RobotStop, law: Law = Law.EXACT) -> None:
        cell = surg_core.load_cell(paths.ROOT / "cells" / "sim_ur5e")
        arm = cell.arms["PSM1"]
        self.law, self.world = law, World(cell)
        self.injector = Injector(self.world, [stop], lockstep=True)
        self.controller = surg_core.Controller(
            arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool, law=law
        )
        self.controller.set_rcm(arm.trocar.p_BRcm)
        self.out = self.step()
        assert self.controller.request(StateCommand.HOME) == Reason.NONE
        assert self.controller.request(StateCommand.ENABLE) == Reason.NONE
        for _ in range(20):
            self.step()
        p = self.controller.X_BR[:3, :3].T @ (self.out.p_set - self.out.p_BRcm)
        self.depth, self.x = float(p[2]), 0.0

    def step(self, *commands: MotionCommand) -> surg_core.Outputs:
        """One tick of both."""
        ((_, state),) = self.injector.states("PSM1", self.world.tick)
        condition, _ = self.injector.robot("PSM1")
        self.out = self.controller.step(
            state.q,
            state.qd,
            list(commands),
            jaw=state.jaw,
            readings=surg_core.Readings(condition=condition),
        )
        by_twist = self.law == Law.VELOCITY
        qd, twist = np.array(self.out.qd_command), np.array(self.out.twist_command)
        command = ArmCommand(None if by_twist else qd, twist if by_twist else None, 0.2)
        self.world.step(self.injector.commands({"PSM1": (self.world.tick, command)}))
        return self.out

    def stream(self, speed: float) -> surg_core.Outputs:
        """Sideways at a speed [m/s]."""
        self.x += speed * 0.002
        p = [self.x, 0.0, self.depth]
        return self.step(MotionCommand(Motion.SERVO_CP, 1, p=p, rotation=[0, 0, 0, 1]))

    @property
    def tip(self) -> np.ndarray:
        """The true tip in the base [m]."""
        return np.array(self.world.truth("PSM1").tip)


@pytest.mark.parametrize("law", [Law.EXACT, Law.VELOCITY], ids=["joint link", "twist link"])
@pytest.mark.parametrize("scale", SPEEDS)
def test_f33_a_robot_that_stops_faults_at_once_and_does_not_leap_when_unlocked(
    full: bool, reactions: Reactions, law: Law, scale: str
) -> None:
    seen, unlocked, after = [], [], []
    for seed in range(100 if full else 3):
        rng = np.random.default_rng(seed)
        at, ticks = int(rng.integers(150, 400)), int(rng.integers(300, 700))
        condition = HALTS[seed % len(HALTS)]
        loop = Loop(RobotStop(arm="PSM1", at=at, ticks=ticks, condition=condition), law)
        while loop.world.tick < at:
            assert loop.stream(SPEEDS[scale]).state == State.ENABLED, loop.out.reason
        for tick in range(at, at + ticks):
            loop.stream(SPEEDS[scale])
            if loop.out.state == State.FAULT:
                seen.append(tick - at)
                break
        assert loop.out.reason == Reason.ROBOT
        assert not np.any(loop.out.qd_command) and not np.any(loop.out.twist_command)
        while loop.world.tick < at + ticks:
            assert not np.any(loop.stream(SPEEDS[scale]).qd_command)
            for word in (StateCommand.ENABLE, StateCommand.HOME):
                assert loop.controller.request(word) == Reason.ROBOT
        rest = loop.tip
        for _ in range(300):  # unlocked, and the sender goes on as if nothing had happened
            assert loop.stream(SPEEDS[scale]).state == State.FAULT
        unlocked.append(1e3 * float(np.linalg.norm(loop.tip - rest)))
        assert loop.controller.request(StateCommand.ENABLE) == Reason.NONE
        for _ in range(300):
            assert loop.step().state == State.ENABLED, loop.out.reason
        after.append(1e3 * float(np.linalg.norm(loop.tip - rest)))
    name = f"simulated robot stops, {scale}, {'twist' if law == Law.VELOCITY else 'joint'} link"
    reactions.add("F33", name, "FAULT(robot), zero commanded", seen, 0)
    reactions.add("F33", name, "true tip after the unlock", unlocked, 0.001, "mm")
    # It stopped by itself, not through the law: it may have to go back onto the pivot.
    reactions.add("F33", name, "true tip after enable", after, 0.01, "mm")


def test_f33_a_slowed_robot_is_ramped_and_faults(reactions: Reactions) -> None:
    loop = Loop(RobotStop(arm="PSM1", at=300, condition="slowed", scaling=0.5))
    while loop.world.tick < 300:
        loop.stream(0.03)
    begin, away = loop.tip, 0.0
    loop.stream(0.03)
    assert (loop.out.state, loop.out.reason) == (State.FAULT, Reason.ROBOT)
    assert np.any(loop.out.qd_command), "a ramp"
    for _ in range(200):
        loop.stream(0.03)
        away = max(away, float(loop.world.truth("PSM1").deviation))
    assert not np.any(np.abs(loop.out.qd_command) > 1e-3)
    assert np.linalg.norm(loop.tip - begin) < 0.002
    name = "simulated robot obeys at half the speed"
    reactions.add("F33", name, "true deviation in the ramp", [1e3 * away], 0.5, "mm")


def test_f33_a_robot_that_is_offline_is_a_lost_link() -> None:
    loop = Loop(RobotStop(arm="PSM1", at=300, ticks=50, condition="offline"))
    while loop.world.tick < 300:
        loop.stream(0.012)
    loop.stream(0.012)
    assert (loop.out.state, loop.out.reason) == (State.FAULT, Reason.LINK_LOST)
    for _ in range(30):
        loop.stream(0.012)
    assert not np.any(loop.out.qd_command), "it has faded"
    assert loop.controller.request(StateCommand.ENABLE) == Reason.LINK_LOST


@pytest.mark.parametrize("law", [Law.EXACT, Law.VELOCITY], ids=["joint link", "twist link"])
@pytest.mark.parametrize("scale", SPEEDS)
def test_an_arm_that_never_moves_is_paused_although_its_link_says_active(
    reactions: Reactions, law: Law, scale: str
) -> None:
    """Its commands arrive nowhere: a wrong topic, a clamp, a link that lies."""
    cell = surg_core.load_cell(paths.ROOT / "cells" / "sim_ur5e")
    arm = cell.arms["PSM1"]
    controller = surg_core.Controller(
        arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool, law=law
    )
    controller.set_rcm(arm.trocar.p_BRcm)
    q = np.array(arm.robot.home)
    out = controller.step(q, 0 * q)
    for word in (StateCommand.HOME, StateCommand.ENABLE):
        assert controller.request(word) == Reason.NONE
    depth = float(np.linalg.norm(out.p_BTip - out.p_BRcm))
    waited = 0
    while out.state != State.PAUSED:
        waited += 1
        x = 0.004 * math.sin(SPEEDS[scale] * waited * 0.002 / 0.004)
        pose = MotionCommand(Motion.SERVO_CP, 1, p=[x, 0.0, depth], rotation=[0, 0, 0, 1])
        out = controller.step(q, 0 * q, [pose])
        assert waited < 2000, "nobody noticed"
    assert out.reason == Reason.NOT_FOLLOWING
    name = f"arm stands still, {scale}, {'twist' if law == Law.VELOCITY else 'joint'} link"
    most = 0.5 if scale == "scale 1" else 1.5
    reactions.add("F33", name, "PAUSED(not_following)", [0.002 * waited], most, "s")


def test_f33_the_sessions_without_ros_hear_the_condition() -> None:
    from surg_sim.envs.cell_session import CellSession

    session = CellSession("cells/sim_two_arms", "bgr", seed=3)
    for words in ((), (StateCommand.HOME,), (StateCommand.ENABLE,)):
        out = session.tick({"PSM1": words}).outputs["PSM1"]
    assert out.state == State.ENABLED
    session.world.link("PSM1").condition = RobotCondition.ESTOP
    outputs = session.tick().outputs
    assert (outputs["PSM1"].state, outputs["PSM1"].reason) == (State.FAULT, Reason.ROBOT)
    assert outputs["ECM"].reason == Reason.NONE
