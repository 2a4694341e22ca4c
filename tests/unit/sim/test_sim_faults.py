"""Faults on purpose: each does what it says, at its tick, the same for one seed."""

from __future__ import annotations

import itertools
import json
import math

import numpy as np
import pytest

import surg_core
from surg_cli.host import paths
from surg_core import Reason, RobotCondition, State, StateCommand
from surg_core.contract import TICK
from surg_sim.envs.cell_session import CellSession
from surg_sim.nodes.fault_injector import Channel, Injector, tool_errors
from surg_sim.nodes.faults import KINDS, FaultError, Wire, parse
from surg_sim.physics.sim_arm import ArmCommand, ToolError
from surg_sim.physics.trocar import TrocarParameters, shaft_in_flange
from surg_sim.physics.trocar_motion import MovingPoint, Sinusoid
from surg_sim.physics.world import World

CELLS = {name: paths.ROOT / "cells" / name for name in ("sim_ur5e", "sim_panda")}
ARMS = ("PSM1",)


@pytest.fixture(params=CELLS)
def cell(request: pytest.FixtureRequest) -> surg_core.Cell:
    return surg_core.load_cell(CELLS[request.param])


@pytest.fixture
def ur5e() -> surg_core.Cell:
    return surg_core.load_cell(CELLS["sim_ur5e"])


class Link:
    """A world behind its faults, driven by joint velocities that answer each state."""

    def __init__(self, cell: surg_core.Cell, *faults: dict, seed: int = 0, lockstep: bool) -> None:
        self.world = World(cell)
        known = parse(json.dumps(list(faults)), ARMS)
        self.injector = Injector(self.world, known, seed, lockstep)
        self.velocity = np.zeros(len(self.world.state("PSM1").q))
        self.velocity[0] = 0.05

    def tick(self) -> list[tuple[int, np.ndarray]]:
        """One tick: what arrives of the state (stamp in ticks, q), then its answer is executed."""
        now = self.world.tick
        arrived = [(s, state.q) for s, state in self.injector.states("PSM1", now)]
        command = ArmCommand(velocity=self.velocity, jaw=0.4)
        self.world.step(self.injector.commands({"PSM1": (now, command)}))
        return arrived

    def run(self, ticks: int) -> list[list[tuple[int, np.ndarray]]]:
        return [self.tick() for _ in range(ticks)]


def test_without_faults_nothing_changes(cell: surg_core.Cell) -> None:
    link, bare = Link(cell, lockstep=True), World(cell)
    for _ in range(50):
        link.tick()
        bare.step({"PSM1": ArmCommand(velocity=link.velocity, jaw=0.4)})
    assert link.world.hash == bare.hash
    assert link.injector.active == []


@pytest.mark.parametrize("lockstep", [True, False])
@pytest.mark.parametrize("quantity", ["position", "velocity"])
@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_f02_one_joint_is_not_finite_for_its_ticks_only(
    ur5e: surg_core.Cell, lockstep: bool, quantity: str, value: str
) -> None:
    fault = {"fault": "not_finite", "at": 5, "ticks": 3, "joint": 2}
    link = Link(ur5e, {**fault, "quantity": quantity, "value": value}, lockstep=lockstep)
    for tick in range(1, 12):
        ((_, state),) = link.injector.states("PSM1", tick)
        spoilt, other = (state.q, state.qd) if quantity == "position" else (state.qd, state.q)
        assert np.isfinite(other).all()
        expected = [2] if 5 <= tick < 8 else []
        assert list(np.flatnonzero(~np.isfinite(spoilt))) == expected
        if expected:
            assert spoilt[2] == float(value) or (value == "nan" and math.isnan(spoilt[2]))
        link.tick()
    assert np.isfinite(link.world.state("PSM1").q).all()


def test_f10_a_frozen_link_is_silent_and_hears_nothing(cell: surg_core.Cell) -> None:
    link = Link(cell, {"fault": "freeze", "at": 20, "ticks": 80}, lockstep=False)
    arrived = link.run(130)
    assert [len(packets) for packets in arrived] == [1] * 19 + [0] * 80 + [1] * 31
    assert [p[0][0] for p in arrived if p] == [*range(1, 20), *range(100, 131)]
    # 20 ticks without a command: the drives' own dead-man; the first command after it frees them.
    link = Link(cell, {"fault": "freeze", "at": 20, "ticks": 80}, lockstep=False)
    stopped = []
    for _ in range(130):
        link.tick()
        stopped.append(link.world.link("PSM1").dead_man)
    assert stopped.index(True) == 19 + 20
    assert stopped[19 + 20 : 99] == [True] * 60 and not any(stopped[99:])


def test_a_frozen_link_shows_its_last_state_in_lockstep(ur5e: surg_core.Cell) -> None:
    link = Link(ur5e, {"fault": "freeze", "at": 20, "ticks": 10}, lockstep=True)
    truth, shown = [], []
    for tick in range(1, 40):
        truth.append(link.world.state("PSM1").q)
        ((stamp, q),) = link.tick()
        assert stamp == tick
        shown.append(q)
    for tick, q in enumerate(shown, 1):
        expected = truth[18] if 20 <= tick < 30 else truth[tick - 1]
        assert np.array_equal(q, expected), tick


@pytest.mark.parametrize("burst", [1, 5, 20])
@pytest.mark.parametrize("loss", [0.01, 0.05])
def test_f11_a_wire_loses_what_it_says(loss: float, burst: int, full: bool) -> None:
    count = 200_000 if full else 40_000
    wire = Wire(arm="PSM1", loss=loss, burst=burst)
    channel: Channel[int] = Channel(wire, np.random.default_rng(4))
    got = [n for k in range(count) for n in channel.transmit(k)]
    gaps = np.diff([-1, *got]) - 1
    lost = gaps[gaps > 0]
    print(f"{loss} x {burst}: {channel.lost} of {count} lost, longest gap {lost.max()}")
    assert len(got) == count - channel.lost and got == sorted(set(got))
    assert lost.min() == burst and set(lost % burst) == {0}
    # One loss per 1/loss packets that could begin one; three standard deviations.
    begun = channel.lost / burst
    expected = loss * (count - channel.lost + begun)
    assert abs(begun - expected) < 3.5 * math.sqrt(expected)


def test_f11_a_wire_doubles_and_swaps_what_it_says(full: bool) -> None:
    count = 100_000 if full else 20_000
    wire = Wire(arm="PSM1", duplicate=0.02, reorder=0.03)
    channel: Channel[int] = Channel(wire, np.random.default_rng(5))
    arrivals = [channel.transmit(k) for k in range(count)]
    got = [n for arrived in arrivals for n in arrived]
    assert set(got) >= set(range(count - 1)) and channel.lost == 0
    late = sum(b < a for a, b in itertools.pairwise(got))
    twice = sum(b == a for a, b in itertools.pairwise(got))
    print(f"{count} packets: {channel.doubled} twice, {channel.swapped} late")
    assert (late, twice) == (channel.swapped, channel.doubled)
    assert (
        abs(channel.swapped / count - 0.03) < 0.005 and abs(channel.doubled / count - 0.02) < 0.005
    )
    # A late packet comes right behind its successor: one tick late, never more.
    assert max(k - n for k, arrived in enumerate(arrivals) for n in arrived) == 1


@pytest.mark.parametrize("lockstep", [True, False])
def test_one_seed_is_one_run(ur5e: surg_core.Cell, lockstep: bool) -> None:
    wires = [
        {"fault": "wire", "topic": topic, "loss": 0.2, "burst": 2, "duplicate": 0.1, "reorder": 0.1}
        for topic in ("robot/measured_js", "robot/servo_jv")
    ]

    def story(seed: int) -> tuple[str, list[int]]:
        link = Link(ur5e, *wires, seed=seed, lockstep=lockstep)
        rng = np.random.default_rng(0)
        stamps = []
        for _ in range(150):
            link.velocity = rng.uniform(-0.05, 0.05, len(link.velocity))
            stamps += [stamp for stamp, _ in link.tick()]
        return link.world.hash, stamps

    first, again, other = story(7), story(7), story(8)
    assert first == again
    assert first[0] != other[0]
    assert first[1] == list(range(1, 151)) if lockstep else first[1] != other[1]


def test_a_state_that_is_asked_for_again_is_the_same(ur5e: surg_core.Cell) -> None:
    """The bridge publishes a state again when nobody answers: no new draw of the wire."""
    wire = {"fault": "wire", "topic": "robot/measured_js", "loss": 0.5, "reorder": 0.3}
    calm, asked = (Link(ur5e, wire, lockstep=True) for _ in range(2))
    for tick in range(1, 60):
        asked.injector.states("PSM1", tick)
        a, b = calm.tick(), asked.tick()
        assert a[0][0] == b[0][0] and np.array_equal(a[0][1], b[0][1])


def test_in_lockstep_a_lossy_wire_shows_the_newest_that_came(ur5e: surg_core.Cell) -> None:
    wire = {"fault": "wire", "topic": "robot/measured_js", "loss": 0.3, "reorder": 0.2, "at": 2}
    link = Link(ur5e, wire, lockstep=True)
    truth: list[float] = []
    seen = 0
    for tick in range(1, 200):
        truth.append(link.world.state("PSM1").q[0])
        ((stamp, q),) = link.tick()
        assert stamp == tick
        newest = max(k for k, value in enumerate(truth) if value == q[0])
        assert newest >= seen, "content never goes back in time"
        seen = newest
    assert 150 < seen < 200


def test_every_other_state_late_in_lockstep(ur5e: surg_core.Cell) -> None:
    wire = {"fault": "wire", "topic": "robot/measured_js", "reorder": 1.0, "at": 2}
    link = Link(ur5e, wire, lockstep=True)
    truth, shown = [], []
    for _ in range(9):
        truth.append(link.world.state("PSM1").q)
        shown.append(link.tick()[0][1])
    # 2 is held back; with 3 both come, and 3 is the newer one. And so on.
    for tick, content in enumerate([1, 1, 3, 3, 5, 5, 7, 7, 9], 1):
        assert np.array_equal(shown[tick - 1], truth[content - 1]), tick


def test_a_link_takes_the_newest_of_what_comes_in_a_tick(ur5e: surg_core.Cell) -> None:
    """With every other packet late, what is executed is the newest that came, tick by tick."""
    wire = {"fault": "wire", "topic": "robot/servo_jv", "reorder": 1.0, "at": 2}
    link = Link(ur5e, wire, lockstep=True)
    executed = []
    for tick in range(1, 20):
        command = ArmCommand(velocity=np.full(6, float(tick)))
        out = link.injector.commands({"PSM1": (tick, command)})["PSM1"].velocity
        executed.append(None if out is None else out[0])
        link.world.step({})
    # Tick 2 is held back; with 3 both come, in the wrong order: 3 counts, 2 is too old. And so on.
    assert executed[:7] == [1.0, None, 3.0, None, 5.0, None, 7.0]


def test_a_lost_answer_is_not_executed(ur5e: surg_core.Cell) -> None:
    link = Link(
        ur5e, {"fault": "wire", "topic": "robot/servo_jv", "loss": 1.0, "at": 10}, lockstep=True
    )
    link.run(200)
    assert link.world.link("PSM1").dead_man
    assert link.world.state("PSM1").jaw > 0.1  # the tool's wire is another one


@pytest.mark.parametrize("lockstep", [True, False])
def test_f31_a_lost_tool_link_says_nothing_and_takes_nothing(
    ur5e: surg_core.Cell, lockstep: bool
) -> None:
    link = Link(ur5e, {"fault": "tool_lost", "at": 5, "ticks": 20}, lockstep=lockstep)
    jaws = []
    for tick in range(1, 30):
        jaw = link.injector.tool("PSM1")
        if 5 <= tick < 25:
            assert jaw is None if not lockstep else math.isnan(jaw[0][0])
            assert link.injector.tool_lost("PSM1")
        else:
            assert jaw is not None and math.isfinite(jaw[0][0])
        link.tick()
        jaws.append(link.world.state("PSM1").jaw)
    # The drive goes on to the last goal it has heard of, and the robot's wire is untouched.
    assert not link.world.link("PSM1").dead_man
    lost = Link(ur5e, {"fault": "tool_lost", "at": 2}, lockstep=lockstep)
    lost.injector.commands({"PSM1": (1, ArmCommand())})
    lost.world.step({})
    before = lost.world.state("PSM1").jaw
    lost.run(20)
    assert lost.world.state("PSM1").jaw == before


def test_f33_a_simulated_robot_that_stops_says_why_and_moves_no_further(
    ur5e: surg_core.Cell,
) -> None:
    fault = {"fault": "robot", "at": 50, "ticks": 100, "condition": "estop"}
    link = Link(ur5e, fault, lockstep=True)
    stopped, joint = [], []
    for _ in range(200):
        if link.injector.robot("PSM1") == (RobotCondition.ESTOP, 1.0):
            stopped.append(link.world.tick)
        link.tick()
        joint.append(link.world.state("PSM1").q[0])
    assert stopped == list(range(50, 150))
    assert abs(joint[147] - joint[100]) < 1e-6 < joint[48] - joint[0]
    slow = Link(ur5e, {**fault, "at": 1, "condition": "slowed", "scaling": 0.3}, lockstep=True)
    slow.tick()
    assert slow.injector.robot("PSM1") == (RobotCondition.SLOWED, 0.3)


def test_f33_the_sessions_without_ros_hear_the_condition() -> None:
    session = CellSession("cells/sim_two_arms", "bgr", seed=3)
    for words in ((), (StateCommand.HOME,), (StateCommand.ENABLE,)):
        out = session.tick({"PSM1": words}).outputs["PSM1"]
    assert out.state == State.ENABLED
    session.world.link("PSM1").condition = RobotCondition.ESTOP
    outputs = session.tick().outputs
    assert (outputs["PSM1"].state, outputs["PSM1"].reason) == (State.FAULT, Reason.ROBOT)
    assert outputs["ECM"].reason == Reason.NONE


def test_a_sinusoid_is_its_own_integral() -> None:
    """Velocity against central differences of the position, seeded families."""
    rng = np.random.default_rng(2)
    for _ in range(200):
        axis = tuple(rng.normal(size=3))
        motion = Sinusoid(rng.uniform(0.001, 0.01), rng.uniform(0.05, 2.0), axis)
        t, h = rng.uniform(0, 10), 1e-5
        numeric = (motion.at(t + h)[0] - motion.at(t - h)[0]) / (2 * h)
        assert np.allclose(motion.at(t)[1], numeric, atol=1e-8)
        assert np.linalg.norm(motion.at(t)[0]) <= motion.amplitude + 1e-15


def test_a_tracker_sees_what_was(full: bool) -> None:
    point = MovingPoint(np.array([0.1, 0.2, 0.3]))
    point.move(Sinusoid(0.005, 0.25, (0.0, 3.0, 4.0)))
    past = [(1, point.p_B, point.v_B)]
    for _ in range(1200):
        point.advance()
        past.append((point.tick, point.p_B, point.v_B))
    for stale in (0, 1, 10, 50, 500):
        tick, p, v = point.observed(stale)
        assert tick == point.tick - stale
        assert np.array_equal(p, past[tick - 1][1]) and np.array_equal(v, past[tick - 1][2])
    young = MovingPoint(np.zeros(3))
    young.advance()
    assert young.observed(50)[0] == 1
    # 5 mm at 0.25 Hz: it has been 5 mm away and moved at 2 pi 0.25 5 = 7.85 mm/s, along the axis.
    offsets = np.array([p for _, p, _ in past]) - past[0][1]
    assert np.linalg.norm(offsets, axis=1).max() == pytest.approx(0.005, rel=1e-4)
    assert max(np.linalg.norm(v) for _, _, v in past) == pytest.approx(0.00785, rel=1e-3)
    assert np.allclose(offsets @ [1.0, 0.0, 0.0], 0.0)


def test_a_moving_trocar_is_the_truth_and_pulls_at_the_shaft(cell: surg_core.Cell) -> None:
    """The arm stands still, so the true deviation is the part of the motion across the shaft."""
    motion = {"fault": "trocar_motion", "at": 2, "amplitude": 0.005, "frequency": 0.25}
    link = Link(cell, {**motion, "axis": [0, 1, 0]}, lockstep=True)
    link.velocity[:] = 0.0
    start = link.world.truth("PSM1")
    worst = 0.0
    for tick in range(1, 1001):
        link.tick()
        truth = link.world.truth("PSM1")
        t = (tick + 1 - 2 + 1) * TICK  # begins at tick 1, is seen from tick 2 on
        moved = np.array([0.0, 0.005 * math.sin(2 * math.pi * 0.25 * t), 0.0])
        assert np.allclose(truth.trocar - start.trocar, moved, atol=1e-12)
        across = moved - (moved @ truth.shaft_axis) * truth.shaft_axis
        worst = max(worst, abs(truth.deviation - np.linalg.norm(across)))
    assert worst < 2e-4, "the shaft is bent aside by the wall's few newtons only"
    # After a second the hole is at its farthest: the wall pulls with k times the displacement.
    quiet = Link(cell, {**motion, "axis": [0, 1, 0], "frequency": 0.02}, lockstep=True)
    quiet.velocity[:] = 0.0
    quiet.run(1000)
    truth = quiet.world.truth("PSM1")
    spring = TrocarParameters().stiffness * (truth.trocar_loaded - truth.trocar)
    assert np.linalg.norm(spring) > 0.1
    assert np.allclose(truth.trocar_force, spring, atol=0.15 * np.linalg.norm(spring) + 0.05)


def test_the_wall_is_damped_against_the_moving_hole(ur5e: surg_core.Cell) -> None:
    """The shaft holds the wall still: the seal feels c v0 while the hole passes its middle."""
    motion = {"fault": "trocar_motion", "at": 2, "amplitude": 0.005, "frequency": 2.0}
    link = Link(ur5e, {**motion, "axis": [0, 1, 0]}, lockstep=True)
    link.velocity[:] = 0.0
    link.run(500)  # two periods
    truth = link.world.truth("PSM1")
    speed = 2 * math.pi * 2.0 * 0.005
    expected = -TrocarParameters().damping * speed
    assert truth.trocar_force[1] == pytest.approx(expected, rel=0.2)


def test_f23_a_trocar_jumps_at_its_tick_and_stays(ur5e: surg_core.Cell) -> None:
    link = Link(
        ur5e, {"fault": "trocar_jump", "at": 30, "offset": [0.003, 0.0, -0.004]}, lockstep=True
    )
    start = link.world.truth("PSM1").trocar
    for tick in range(1, 60):
        offset = link.world.truth("PSM1").trocar - start
        assert np.allclose(offset, [0.003, 0, -0.004] if tick >= 30 else 0.0, atol=1e-15)
        seen = link.injector.track("PSM1", 10)
        assert seen is not None
        assert np.allclose(seen[1] - start, [0.003, 0, -0.004] if tick >= 40 else 0.0, atol=1e-15)
        link.tick()
    # It goes on from there: a motion begins where the hole is, and ends where it stops.
    for fault in parse('[{"fault": "trocar_motion", "amplitude": 0.002, "frequency": 1}]', ARMS):
        link.injector.add(fault)
    link.run(126)
    for fault in parse('{"fault": "trocar_motion", "amplitude": 0}', ARMS):
        link.injector.add(fault)
    link.run(2)
    rest = link.world.truth("PSM1").trocar
    assert np.linalg.norm(rest - start - [0.003, 0, -0.004]) == pytest.approx(0.002, rel=1e-3)
    link.run(20)
    assert np.array_equal(link.world.truth("PSM1").trocar, rest)
    link.world.reset()
    assert np.array_equal(link.world.truth("PSM1").trocar, start)


def test_a_lost_tracker_is_silent(ur5e: surg_core.Cell) -> None:
    link = Link(ur5e, {"fault": "track_lost", "at": 10, "ticks": 5}, lockstep=False)
    heard = []
    for _ in range(20):
        heard.append(link.injector.track("PSM1", 10) is not None)
        link.tick()
    assert heard == [True] * 9 + [False] * 5 + [True] * 6


def test_the_tool_is_off_by_what_is_said(cell: surg_core.Cell) -> None:
    arm = cell.arms["PSM1"]
    believed_p, believed_s = shaft_in_flange(arm)
    for seed in range(20):
        errors = tool_errors(parse('{"fault": "tool_off"}', ARMS), seed)
        p, s = shaft_in_flange(arm, errors["PSM1"])
        assert np.linalg.norm(p - believed_p) == pytest.approx(0.001, rel=1e-9)
        assert abs((p - believed_p) @ believed_s) < 1e-12
        assert math.degrees(math.acos(s @ believed_s)) == pytest.approx(0.5, rel=1e-9)
    assert not np.allclose(
        shaft_in_flange(arm, ToolError(0.001, 0.01, 0))[0],
        shaft_in_flange(arm, ToolError(0.001, 0.01, 1))[0],
    )


def test_a_tool_that_is_off_shows_in_the_truth_and_rests(cell: surg_core.Cell) -> None:
    """Kinematic and true deviation fall apart, and the start is no shock for arm and wall."""
    arm = cell.arms["PSM1"]
    for seed in range(3):
        world = World(cell, tool_errors={"PSM1": ToolError(0.001, math.radians(0.5), seed)})
        home = world.state("PSM1").q
        X_BF = arm.chain.forward(home)
        p, s = shaft_in_flange(arm, ToolError(0.001, math.radians(0.5), seed))
        p_B, s_B = X_BF[:3, :3] @ p + X_BF[:3, 3], X_BF[:3, :3] @ s
        truth = world.truth("PSM1")
        assert np.allclose(truth.tip, p_B, atol=1e-8) and np.allclose(
            truth.shaft_axis, s_B, atol=1e-8
        )
        d = np.asarray(arm.trocar.p_BRcm) - p_B
        assert truth.deviation == pytest.approx(np.linalg.norm(d - (d @ s_B) * s_B), abs=1e-8)
        assert 1e-4 < truth.deviation < 0.0021  # 1 mm at the tip, 0.12 m x 0.5 deg at the trocar
        # The wall begins where the shaft is, not where it was taught.
        loaded = truth.trocar_loaded - p_B
        assert np.linalg.norm(loaded - (loaded @ s_B) * s_B) < 1e-7
        for _ in range(200):
            world.step({})
        drift = np.abs(world.state("PSM1").q - home).max()
        print(f"seed {seed}: {truth.deviation * 1e3:.3f} mm, drift {drift:.1e} rad")
        assert drift < 1e-4
        assert world.truth("PSM1").deviation == pytest.approx(truth.deviation, abs=1e-4)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "no JSON"),
        ("7", "'fault' must be one of"),
        ('{"fault": "gremlin"}', "not_finite, freeze"),
        ('{"fault": "freeze", "for": 3}', "no 'for': allowed are arm, at, ticks"),
        ('{"fault": "freeze", "ticks": -1}', "ticks is -1"),
        ('{"fault": "freeze", "ticks": 1.5}', "whole number"),
        ('{"fault": "freeze", "ticks": true}', "ticks is True"),
        ('{"fault": "freeze", "arm": "PSM9"}', "allowed are PSM1"),
        ('{"fault": "freeze", "arm": 3}', "arm is 3"),
        ('{"fault": "wire", "loss": 1.1}', "from 0 to 1"),
        ('{"fault": "wire", "loss": NaN}', "loss is nan"),
        ('{"fault": "wire", "topic": "cycle"}', "robot/measured_js"),
        ('{"fault": "robot", "condition": "active"}', "stopped"),
        ('{"fault": "robot", "scaling": 2}', "from 0 to 1"),
        ('{"fault": "trocar_jump"}', "offset is missing"),
        ('{"fault": "trocar_jump", "offset": [0, 0]}', "3 numbers"),
        ('{"fault": "trocar_jump", "offset": ["0", "0", "1"]}', "3 numbers"),
        ('{"fault": "trocar_jump", "offset": [true, 0, 0]}', "3 numbers"),
        ('{"fault": "freeze", "for": {}}', "no 'for'"),
        ('{"fault": "trocar_jump", "offset": [0, 0, 9]}', "length up to 0.1"),
        ('{"fault": "trocar_motion", "amplitude": 0.005, "axis": [0, 0, 0]}', "axis is [0, 0, 0]"),
        ('{"fault": "trocar_motion", "amplitude": "5 mm"}', "'5 mm'"),
    ],
)
def test_a_bad_fault_is_refused_with_what_is_allowed(text: str, words: str) -> None:
    with pytest.raises(FaultError, match=r".") as caught:
        parse(text, ARMS)
    assert words in str(caught.value)


def test_a_fault_that_does_not_fit_the_world_is_refused(ur5e: surg_core.Cell) -> None:
    injector = Injector(World(ur5e))
    with pytest.raises(FaultError, match="0 to 5"):
        injector.add(parse('{"fault": "not_finite", "joint": 6}', ARMS)[0])
    with pytest.raises(FaultError, match="at the start"):
        injector.add(parse('{"fault": "tool_off"}', ARMS)[0])
    with pytest.raises(FaultError, match="PSM2"):
        injector.add(parse('{"fault": "freeze"}', ("PSM2",))[0])


def test_every_kind_reads_back() -> None:
    needed = {"trocar_motion": {"amplitude": 0.005}, "trocar_jump": {"offset": [0.001, 0, 0]}}
    for kind in KINDS:
        (fault,) = parse(json.dumps({"fault": kind, "at": 3, **needed.get(kind, {})}), ARMS)
        assert fault.kind == kind and fault.at == 3 and fault.arm == "PSM1"
    assert parse("  ", ARMS) == []
