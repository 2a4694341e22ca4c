"""A hand that holds a wristed instrument: its whole orientation, judged by the simulator's tip."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

import surg_core
from helpers.control.lagging_arm import SOURCE, TICK, asked, view_of
from helpers.policy.policy_bench import FakeArm
from helpers.sim.wrist_follow import ARM, WristedArm, angles
from helpers.teleop.hand import Hand
from surg_cli.host import paths
from surg_core.arm_view import ArmCommands, JawRange
from surg_teleop.follow.target_pose import StepLimits
from surg_teleop.follow.teleop_setup import read_setup
from surg_teleop.follow.teleop_types import CameraView, ControlMode, Reason, TeleopState
from surg_teleop.playback.motion_file import read_motion
from surg_teleop.playback.motion_plan import make_plan
from surg_teleop.playback.motion_player import Mode, MotionPlayer, PlayerStage
from surg_teleop.playback.workspace_fit import Workspace

Array = NDArray[np.float64]
NODE = "/teleop"
SCALE = 0.5
FASTEST = 12.0  # [rad/s] of the true tip: the wrist's 8 and the roll's 2, or 4 on the Panda


@dataclass
class Bench:
    """A hand, the teleoperation of a cell as the node reads it, and the arm in the simulator."""

    robot: str = "ur5e"
    mapping: str = "position"
    R_WV: Array = field(default_factory=lambda: np.eye(3))
    hand: Hand = field(default_factory=lambda: Hand(grip=None))
    tips: list[Array] = field(default_factory=list)

    def __post_init__(self) -> None:
        folder = paths.ROOT / f"cells/sim_{self.robot}_wrist"
        self.arm = WristedArm(surg_core.load_cell(folder))
        given = {"cell": str(folder), "leader": "gamepad", "view": [0, 0, 0, 1], "scale": SCALE}
        setup = read_setup({**given, "mapping": self.mapping}, NODE)
        self.teleop = setup.hands[0].switch.arms[ARM]
        self.ticks, self.refused, self.deviation = 0, 0, 0.0
        self.said: set[Reason] = set()
        self.commands = ArmCommands()
        self.tick()

    def tick(self) -> None:
        """One cycle of the arm and one of the teleoperation."""
        self.ticks += 1
        commands = asked(self.commands, self.arm.controller)
        out = self.arm.step(*commands)
        self.refused += sum(v.reason != surg_core.Reason.NONE for v in out.verdicts)
        view = view_of(self.arm.arm, self.arm.controller, out, self.ticks, {SOURCE: NODE})
        now = self.ticks * TICK
        found = self.teleop.tick(now, self.hand.sample(now), view, CameraView(self.R_WV, now))
        self.message, self.commands = found.message, found.commands
        self.said.add(found.reason)
        self.tips.append(self.arm.tip())
        if found.state is TeleopState.FOLLOWING:
            self.deviation = max(self.deviation, self.arm.world.truth(ARM).deviation)

    def run(self, seconds: float, act: Callable[[float], None] | None = None) -> None:
        """Ticks; ``act`` moves the hand, with the time since the start [s]."""
        for k in range(round(seconds / TICK)):
            if act is not None:
                act(k * TICK)
            self.tick()

    def engage(self) -> Bench:
        """Following, at rest."""
        self.teleop.enable()
        self.run(0.3)
        assert self.teleop.state is TeleopState.FOLLOWING, self.message
        return self

    def clutch(self, act: Callable[[float], None]) -> None:
        """Clutched while ``act`` moves the hand for 0.5 s, then following again."""
        self.hand.buttons = {"clutch"}
        self.run(0.5, act)
        self.hand.buttons = set()
        self.run(0.3)
        assert self.teleop.state is TeleopState.FOLLOWING, self.message

    def turned_since(self, tick: int) -> float:
        """Largest angle [rad] of the tip from where it was."""
        R = np.array(self.tips)[tick:, :3, :3]
        return float(angles(R, np.broadcast_to(R[0], R.shape)).max())

    def fastest(self) -> float:
        """Largest angular speed of the tip [rad/s]."""
        R = np.array(self.tips)[:, :3, :3]
        return float(angles(R[:-1], R[1:]).max() / TICK)

    def follows(self, tick: int, start: tuple[Array, Array]) -> tuple[float, float]:
        """How far the tip [m] and the tool [rad] are from what the hand did since a tick.

        Args:
            tick: Index into ``tips``.
            start: Place and orientation of the hand then.
        """
        R_WR = np.asarray(self.arm.arm.X_WB)[:3, :3] @ np.asarray(self.arm.controller.X_BR)[:3, :3]
        R_RV = R_WR.T @ self.R_WV
        turn = R_RV @ self.hand.R @ start[1].T @ R_RV.T
        X, X_0 = self.tips[-1], self.tips[tick]
        p = X_0[:3, 3] + SCALE * R_RV @ (self.hand.p - start[0])
        off = Rotation.from_matrix(turn @ X_0[:3, :3] @ X[:3, :3].T).magnitude()
        return float(np.linalg.norm(p - X[:3, 3])), float(off)


def drawn(seed: int, bench: Bench) -> Callable[[float], None]:
    """A hand that moves by 15 mm and turns by up to 23 degrees about every axis of the picture."""
    draws = np.random.default_rng(seed)
    frequency, phase = draws.uniform(0.2, 0.5, 6), draws.uniform(0.0, 2 * np.pi, 6)
    size = np.repeat([0.015, 0.2], 3)
    p_0, R_0 = bench.hand.p, bench.hand.R

    def move(t: float) -> None:
        grow = 0.5 - 0.5 * math.cos(math.pi * min(t, 1.0))
        x = grow * size * (np.sin(2 * np.pi * frequency * t + phase) - np.sin(phase))
        bench.hand.p = p_0 + x[:3]
        bench.hand.R = Rotation.from_rotvec(x[3:]).as_matrix() @ R_0

    return move


def bench_of(seed: int, robot: str = "ur5e") -> Bench:
    """Hand and view at any orientation."""
    hand = Hand(grip=None, R=Rotation.random(random_state=seed).as_matrix())
    return Bench(robot, R_WV=Rotation.random(random_state=seed + 1000).as_matrix(), hand=hand)


@pytest.mark.parametrize("robot", ["ur5e", "panda"])
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.full)])
def test_the_tip_turns_as_the_hand_does_across_a_clutch(seed: int, robot: str) -> None:
    bench = bench_of(seed, robot)
    before = len(bench.tips) + 50  # it has settled
    bench.run(0.2)
    bench.engage()
    assert bench.turned_since(before) < math.radians(0.1)  # whatever the hand's orientation
    begin, start = len(bench.tips) - 1, (bench.hand.p, bench.hand.R)
    bench.run(3.0, drawn(seed, bench))
    bench.run(1.0)
    far, off = bench.follows(begin, start)
    print(f"{robot} {seed}: {1e3 * far:.3f} mm, {math.degrees(off):.3f} degrees off")
    assert far < 2e-4 and off < math.radians(0.3)

    draws = np.random.default_rng(seed)
    held, spin = len(bench.tips), draws.normal(0.0, 3.0, 3)
    R_0 = bench.hand.R

    def turn(t: float) -> None:
        bench.hand.R = Rotation.from_rotvec(t * spin).as_matrix() @ R_0

    bench.clutch(turn)
    assert bench.turned_since(held) < math.radians(0.3)
    begin, start = len(bench.tips) - 1, (bench.hand.p, bench.hand.R)
    bench.run(2.0, drawn(seed + 50, bench))
    bench.run(1.0)
    far, off = bench.follows(begin, start)
    assert far < 2e-4 and off < math.radians(0.3)
    assert bench.refused == 0
    assert bench.fastest() < FASTEST
    assert bench.deviation < 1e-4


@pytest.mark.parametrize("seed", [0, 1, pytest.param(2, marks=pytest.mark.full)])
def test_the_end_of_a_joint_is_shown_and_never_leapt_over(seed: int) -> None:
    """About one axis to 115 degrees and back: some joint ends; afterwards hand and tip agree."""
    bench = bench_of(seed).engage()
    axis = np.random.default_rng(seed).normal(size=3)
    axis /= np.linalg.norm(axis)
    place, R_0 = bench.tips[-1][:3, 3], bench.hand.R
    begin = len(bench.tips) - 1

    def turn(t: float) -> None:
        angle = 2.0 * (1.0 - math.cos(math.pi * min(t, 4.0) / 2.0)) / 2.0
        bench.hand.R = Rotation.from_rotvec(angle * axis).as_matrix() @ R_0

    bench.run(2.0, turn)
    bench.run(0.5)
    far = float(np.linalg.norm(np.array(bench.tips)[begin:, :3, 3] - place, axis=1).max())
    print(f"{seed}: tip off by {1e3 * far:.2f} mm, {bench.fastest():.1f} rad/s, {bench.said}")
    assert bench.refused == 0
    assert bench.fastest() < FASTEST
    assert bench.deviation < 1e-4
    off = bench.follows(begin, (bench.hand.p, R_0))[1]
    assert {Reason.AT_LIMIT, Reason.LAGGING} & bench.said or off < 0.01


@pytest.mark.parametrize("seed", [0, 1, pytest.param(2, marks=pytest.mark.full)])
def test_a_wild_hand_near_the_singular_pose_leaps_nowhere(seed: int) -> None:
    bench = bench_of(seed + 20).engage()
    draws = np.random.default_rng(seed)
    spins = draws.normal(0.0, 3.0, (8, 3))

    def wild(t: float) -> None:
        bench.hand.turn(TICK * spins[int(2.0 * t)])
        if bench.teleop.state is TeleopState.CLUTCHED:
            bench.teleop.enable()

    bench.run(4.0, wild)
    print(f"{seed}: {bench.fastest():.1f} rad/s, {bench.said}")
    assert bench.refused == 0
    assert bench.fastest() < FASTEST
    assert bench.deviation < 2e-4


def test_a_rate_turns_about_the_axes_of_the_picture_and_must_rest_to_engage() -> None:
    bench = Bench(mapping="rate")
    bench.hand = Hand(grip=None, offers=frozenset({ControlMode.RATE}), tilt=np.array([0.2, 0.0]))
    bench.teleop.enable()
    bench.run(0.3)
    assert bench.teleop.state is TeleopState.WAITING
    assert Reason.LEADER_DEFLECTED in bench.said
    bench.hand.tilt = np.zeros(2)
    bench.engage()
    begin, start = len(bench.tips) - 1, (bench.hand.p, np.eye(3))
    bench.hand.tilt, bench.hand.roll_rate = np.array([0.2, 0.1]), 0.15
    factor = SCALE / 0.2
    bench.run(1.0)
    bench.hand.tilt, bench.hand.roll_rate = np.zeros(2), 0.0
    bench.run(0.5)
    bench.hand.R = Rotation.from_rotvec(factor * np.array([0.2, 0.1, 0.15])).as_matrix()
    far, off = bench.follows(begin, start)
    # A rate that begins at once is ahead of the arm for a moment, and is held back there.
    assert far < 2e-4 and off < math.radians(1.0)
    assert bench.refused == 0


def test_a_locked_rotation_keeps_the_tool_and_a_jump_lets_go() -> None:
    bench = bench_of(7).engage()
    bench.teleop.lock_rotation = True
    held = len(bench.tips) - 1
    bench.run(1.0, lambda t: bench.hand.turn(np.array([0.5 * TICK, 0.0, 0.3 * TICK])))
    assert bench.turned_since(held) < math.radians(0.1)
    bench.teleop.lock_rotation = False
    bench.hand.turn(np.array([0.0, 0.5, 0.0]))
    bench.tick()
    assert bench.teleop.state is TeleopState.CLUTCHED
    assert Reason.HAND_JUMP in bench.said
    bench.run(0.3)
    assert bench.turned_since(held) < math.radians(0.1)


def motion_file(folder: Path, size: tuple[float, float, float]) -> Path:
    """A motion of 4 s with rotations of twice this size [rad] about the axes, at 100 Hz."""
    file, t = folder / "motion.csv", np.linspace(0.0, 4.0, 401)
    phases = np.outer(t, [1.1, 0.9, 0.7]) + np.arange(3)
    wave = (1 - np.cos(np.pi * t / 2))[:, None] * np.sin(phases)
    R = (Rotation.from_rotvec(np.array(size) * wave) * Rotation.random(random_state=1)).as_matrix()
    rows = np.column_stack([t, 0.1 + 0.008 * wave, R.reshape(-1, 9)])
    head = ",".join(["t_s", "x_m", "y_m", "z_m", *(f"r{i}{k}" for i in "123" for k in "123")])
    np.savetxt(file, rows, delimiter=",", header=head, comments="")
    return file


def played(file: Path, mode: Mode = Mode.CARTESIAN) -> tuple[MotionPlayer, Array, Array]:
    """The player at its end; its clock [s] and the true tips (n, 4, 4) while it played."""
    arm = WristedArm(surg_core.load_cell(paths.ROOT / "cells/sim_ur5e_wrist"))
    limits, instrument = arm.arm.limits, arm.arm.instrument
    assert instrument.wrist is not None
    plan = make_plan(
        read_motion(file), Workspace(limits.depth_slow, limits.depth_max, limits.cone), 1.0
    )
    steps = StepLimits.of(limits, instrument.wrist.velocity)
    jaw = JawRange(instrument.jaw_min, instrument.jaw_max)
    wrist = instrument.wrist
    player = MotionPlayer(plan, mode, jaw, steps, wrist, limits.roll_max)
    commands, clock, tips = ArmCommands(), [], []
    for tick in range(1, 6000):
        out = arm.step(*asked(commands, arm.controller))
        if player.done:
            break
        commands = player.tick(view_of(arm.arm, arm.controller, out, tick))
        if player.stage is PlayerStage.PLAY:
            clock.append(player.clock)
            tips.append(arm.tip())
    assert player.done
    return player, np.array(clock), np.array(tips)


def off_its_place(player: MotionPlayer, clock: Array, tips: Array) -> float:
    """Largest distance [m] of the true tips from the plan, less the arm's delay."""
    places = np.array([player.plan.at(t)[0] for t in clock])
    ways = [tips[60:, :3, 3] - places[60 - late : len(places) - late] for late in range(60)]
    return min(float(np.linalg.norm(way, axis=1).max()) for way in ways)


@pytest.mark.parametrize("mode", list(Mode))
def test_a_played_motion_turns_the_tool_as_the_file_says(tmp_path: Path, mode: Mode) -> None:
    file = motion_file(tmp_path, (0.35, 0.35, 0.35))
    player, clock, tips = played(file, mode)
    assert player.stage is PlayerStage.DONE, player.reason
    table = np.genfromtxt(file, delimiter=",", names=True)
    R = np.stack([table[f"r{i}{k}"] for i in "123" for k in "123"], axis=1).reshape(-1, 3, 3)
    told = Slerp(table["t_s"], Rotation.from_matrix(R))
    first, last = player.plan.window
    inside = np.flatnonzero((clock > first) & (clock < last))
    begin = inside[100]
    worst = []
    for late in range(60):  # the arm's delay [ticks]
        now, t = tips[inside[200:], :3, :3], clock[inside[200:] - late] - first
        turned = Rotation.from_matrix(now @ tips[begin, :3, :3].T)
        meant = told(t) * told(clock[begin - late] - first).inv()
        worst.append(float((turned * meant.inv()).magnitude().max()))
    far = off_its_place(player, clock, tips)
    print(f"{math.degrees(min(worst)):.2f} degrees, {1e3 * far:.2f} mm, {player.refused} refused")
    assert min(worst) < math.radians(1.0) and far < 5e-4
    assert player.refused == 0


@pytest.mark.parametrize("mode", list(Mode))
def test_a_played_motion_without_rotations_keeps_the_wrist_straight(
    tmp_path: Path, mode: Mode
) -> None:
    t = np.linspace(0.0, 3.0, 301)
    wave = 0.01 * (1 - np.cos(np.pi * t / 1.5))
    rows = np.column_stack([t, wave, wave, 0.0 * t, 50.0 * wave])
    head = "t_s,x_m,y_m,z_m,roll_rad"
    np.savetxt(tmp_path / "motion.csv", rows, delimiter=",", header=head, comments="")
    player, clock, tips = played(tmp_path / "motion.csv", mode)
    assert player.stage is PlayerStage.DONE, player.reason
    along = tips[:, :3, 3] / np.linalg.norm(tips[:, :3, 3], axis=1, keepdims=True)
    bent = float(np.linalg.norm(tips[:, :3, 2] - along, axis=1).max())
    far = off_its_place(player, clock, tips)
    print(f"bent {bent:.4f} rad, {1e3 * far:.2f} mm")
    assert bent < 0.01 and far < 5e-4 and player.refused == 0


def test_a_played_motion_beyond_the_wrist_keeps_the_place_of_the_tip(tmp_path: Path) -> None:
    player, clock, tips = played(motion_file(tmp_path, (0.75, 0.0, 0.0)))
    assert player.stage is PlayerStage.DONE, player.reason
    far = off_its_place(player, clock, tips)
    print(f"{1e3 * far:.2f} mm, {player.refused} refused, slowed {player.slowed_ns / 1e9:.2f} s")
    assert player.refused == 0
    assert far < 2e-3


def test_a_turn_that_no_wrist_can_make_is_told_by_its_line(tmp_path: Path) -> None:
    """Beyond a right angle the pitch would have to leap to its other side."""
    t = np.linspace(0.0, 4.0, 401)
    turn = Rotation.from_euler("y", 2.6 * np.exp(-(((t - 2.0) / 0.4) ** 2))).as_matrix()
    rows = np.column_stack([t, 0.01 * np.sin(t), 0.0 * t, 0.0 * t, turn.reshape(-1, 9)])
    head = ",".join(["t_s", "x_m", "y_m", "z_m", *(f"r{i}{k}" for i in "123" for k in "123")])
    np.savetxt(tmp_path / "motion.csv", rows, delimiter=",", header=head, comments="")
    cell = surg_core.load_cell(paths.ROOT / "cells/sim_ur5e_wrist").arms[ARM]
    wrist, limits = cell.instrument.wrist, cell.limits
    assert wrist is not None
    workspace = Workspace(limits.depth_slow, limits.depth_max, limits.cone)
    plan = make_plan(read_motion(tmp_path / "motion.csv"), workspace)
    steps = StepLimits.of(limits, wrist.velocity)
    player = MotionPlayer(plan, Mode.CARTESIAN, JawRange(0.0, 1.0), steps, wrist)
    arm = FakeArm(wrist, turn=0.0)  # it is at once where it is told to be
    ready = {"homed": True, "state": surg_core.State.ENABLED}
    for tick in range(1, 5000):
        view = replace(arm.view, stamp_ns=tick * 2_000_000, **ready)
        commands = player.tick(view)
        pose = commands.servo_cp or commands.move_cp
        if player.done:
            break
        if pose is not None:
            arm.set(arm.target_of(pose, 0.3))
    print(player.reason)
    assert player.stage is PlayerStage.FAILED and commands.hold
    assert "the wrist cannot turn" in player.reason and "motion.csv: line" in player.reason
