"""The simulated arm and trocar: kinematics, actuators, truth, determinism."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import surg_core
from surg_cli.host import paths
from surg_core.contract import TICK
from surg_description.make_cell import make_cell
from surg_sim.physics.sim_arm import ActuatorParameters, ArmCommand, robot_part
from surg_sim.physics.trocar import TrocarParameters, shaft_in_flange
from surg_sim.physics.world import World

SOFT = TrocarParameters(stiffness=0.1, friction=0.0)
"""A wall that is not felt, where only the arm is looked at."""
CELLS = {name: paths.ROOT / "cells" / name for name in ("sim_ur5e", "sim_panda")}


@pytest.fixture(params=CELLS)
def cell(request: pytest.FixtureRequest) -> surg_core.Cell:
    return surg_core.load_cell(CELLS[request.param])


@pytest.fixture
def ur5e() -> surg_core.Cell:
    return surg_core.load_cell(CELLS["sim_ur5e"])


def drive(world: World, velocities: np.ndarray) -> np.ndarray:
    """Run joint velocities (ticks, n) through PSM1; returns q at every tick, the first included."""
    q = [world.state("PSM1").q]
    for velocity in velocities:
        world.step({"PSM1": ArmCommand(velocity=velocity)})
        q.append(world.state("PSM1").q)
    return np.array(q)


def test_home_holds_the_shaft_in_the_trocar(cell: surg_core.Cell) -> None:
    truth = World(cell).truth("PSM1")
    assert truth.deviation < 1e-8
    depth = (truth.tip - truth.trocar) @ truth.shaft_axis
    assert depth == pytest.approx(0.120, abs=1e-6)


def test_rest_is_rest(cell: surg_core.Cell) -> None:
    """Weight is compensated and the trocar does not throw the arm: nothing moves in a second."""
    world = World(cell)
    home = world.state("PSM1").q
    q = drive(world, np.zeros((500, len(home))))
    print(f"drift {np.abs(q - home).max():.1e} rad, {world.truth('PSM1').deviation * 1e6:.4f} um")
    assert np.abs(q - home).max() < 1e-7
    assert world.truth("PSM1").deviation < 1e-7


def test_a_velocity_step_answers_with_delay_and_lag(cell: surg_core.Cell) -> None:
    """Two ticks of silence, then a first-order rise; the mean velocity is right."""
    world = World(cell, trocar=SOFT)
    dof = len(world.state("PSM1").q)
    command, found = 0.05, []
    for joint in (0, dof - 1):
        world.reset()
        velocities = np.zeros((300, dof))
        velocities[:, joint] = command
        q = drive(world, velocities)[:, joint]
        assert np.abs(q[2] - q[0]) < 1e-9, "moved before the delay"
        rate = np.diff(q) / TICK
        assert rate[-50:].mean() == pytest.approx(command, rel=1e-3)
        # A delayed first-order lag of a ramp runs behind it by delay + lag.
        behind = (command * TICK * np.arange(len(q)) - (q - q[0]))[-50:].mean() / command
        print(f"joint {joint}: {behind * 1000:.2f} ms behind")
        found.append(behind - 2 * TICK)
    assert found == pytest.approx(ActuatorParameters().lags(dof)[[0, -1]], abs=0.001)
    assert np.ptp(ActuatorParameters().lags(dof)) > 0.005, "joints that lag alike flatter"


MASSES = {"ur3e": (0.5, 4.0), "ur5e": (0.2, 2.0, 3.2, 8.0), "ur10e": (0.4, 2.5, 5.0)}
MASSES |= {"panda": (0.5, 3.0, 6.0)}
"""Arm -> times its mass: those for 20 kg and more have some 2.5 of the UR10e's, or 68 kg."""


@pytest.fixture(params=[(arm, factor) for arm, factors in MASSES.items() for factor in factors])
def heavy(request: pytest.FixtureRequest, tmp_path: Path) -> surg_core.Cell:
    description = paths.ROOT / "src" / "surg_description"
    arm, factor = request.param

    def times(number: re.Match[str]) -> str:
        return f'{number[1]}="{factor * float(number[2])}"'

    text = (description / f"urdf/{arm}.urdf").read_text()
    text = re.sub(r'\b(value|i[xyz][xyz])="([^"]*)"', times, text)
    (tmp_path / "heavy.urdf").write_text(text)
    robot = (description / f"robots/{arm}.yaml").read_text().replace(f"../urdf/{arm}", "heavy")
    (tmp_path / "heavy.yaml").write_text(robot)
    grasper = description / "instruments/grasper.yaml"
    return surg_core.load_cell(make_cell(tmp_path / "heavy.yaml", tmp_path / "cell", grasper))


def test_a_heavy_arm_has_stiffer_drives(heavy: surg_core.Cell) -> None:
    """By a torque, the angle that it gives, and MuJoCo's mass matrix: 165 rad/s at least."""
    world = World(heavy, trocar=SOFT)
    model, data, torque = world.model, world.data, 5.0  # N m, less than any drive has
    M = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    names = [robot_part(heavy.arms["PSM1"], name) for name in heavy.arms["PSM1"].robot.joint_names]
    for i, dof in enumerate(model.joint(name).dofadr[0] for name in names):
        world.reset()
        data.qfrc_applied[dof] = torque
        turned = np.ptp(drive(world, np.zeros((200, len(names))))[:, i])
        data.qfrc_applied[dof] = 0.0
        frequency = np.sqrt(torque / turned / M[dof, dof])
        print(f"{names[i]}: {frequency:.0f} rad/s")
        assert frequency > 165.0


def test_the_servo_hardly_deflects(cell: surg_core.Cell) -> None:
    """Under a surgeon's accelerations the arm follows its drives to some 0.1 mrad."""
    parameters = ActuatorParameters()
    world = World(cell)
    dof = len(world.state("PSM1").q)
    t = np.arange(1500) * TICK
    amplitude, omega = 0.03, 2 * np.pi * 1.0
    wave = (amplitude * omega * np.cos(omega * t))[:, None] * np.linspace(1, 0.5, dof)
    q = drive(world, wave * np.clip(t, 0, 0.5)[:, None] * 2)
    # The drives' own reference: the same commands through the delay and the lag alone.
    delayed = np.vstack([np.zeros((2, dof)), wave * np.clip(t, 0, 0.5)[:, None] * 2])[: len(t)]
    reference, filtered = [q[0]], np.zeros(dof)
    share = 1 - np.exp(-TICK / 2 / parameters.lags(dof))
    for command in delayed:
        step = np.zeros(dof)
        for _ in range(2):
            filtered = filtered + share * (command - filtered)
            step += filtered * TICK / 2
        reference.append(reference[-1] + step)
    deflection = np.abs(q - np.array(reference)).max()
    print(f"deflection {deflection * 1000:.3f} mrad")
    assert deflection < 3e-4


def test_a_twist_moves_the_flange_as_asked(cell: surg_core.Cell) -> None:
    arm = cell.arms["PSM1"]
    world = World(cell)
    twist = np.array([0.01, -0.02, 0.015, 0.05, -0.03, 0.04])
    for _ in range(250):
        world.step({"PSM1": ArmCommand(twist=twist)})
    state = world.state("PSM1")
    step = 1e-6
    before, after = arm.chain.forward(state.q), arm.chain.forward(state.q + step * state.qd)
    v = (after[:3, 3] - before[:3, 3]) / step
    W = (after[:3, :3] @ before[:3, :3].T - np.eye(3)) / step
    omega = np.array([W[2, 1], W[0, 2], W[1, 0]])
    # Measured while the arm turns: the Jacobian of 12 ms ago, so a small difference remains.
    assert np.concatenate([v, omega]) == pytest.approx(twist, abs=2e-3)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (ArmCommand(velocity=np.array([np.nan, 0, 0, 0, 0, 0])), "not finite"),
        (ArmCommand(twist=np.array([0, 0, np.inf, 0, 0, 0])), "not finite"),
        (ArmCommand(velocity=np.zeros(5)), "5 values, 6"),
        (ArmCommand(twist=np.zeros(7)), "7 values, 6"),
    ],
)
def test_an_unusable_command_is_named_and_not_obeyed(
    ur5e: surg_core.Cell, command: ArmCommand, words: str
) -> None:
    world = World(ur5e)
    for _ in range(20):
        world.step({"PSM1": command})
    assert words in world.link("PSM1").fault
    assert np.isfinite(world.data.qpos).all()
    assert np.abs(world.state("PSM1").qd).max() < 1e-6
    world.step({"PSM1": ArmCommand(velocity=np.zeros(6))})
    assert world.link("PSM1").fault == ""


def test_too_fast_is_scaled_in_the_same_direction(ur5e: surg_core.Cell) -> None:
    world = World(ur5e, trocar=SOFT)
    limit = ur5e.arms["PSM1"].robot.velocity
    asked = np.array([4.0, 2.0, -1.0, 0.5, 0.0, 0.0]) * limit
    for _ in range(60):
        world.step({"PSM1": ArmCommand(velocity=asked)})
    qd = world.state("PSM1").qd
    assert np.all(np.abs(qd) <= limit * 1.02)
    assert "velocity limit" in world.link("PSM1").fault
    assert qd[:4] / qd[0] == pytest.approx(asked[:4] / asked[0], abs=0.05)


def test_dead_man_counts_ticks_and_ramps(ur5e: surg_core.Cell) -> None:
    """F10: 40 ms without a command, then a stop within the joints' accelerations."""
    world = World(ur5e)
    link = world.link("PSM1")
    for _ in range(30):
        world.step({})
    assert not link.dead_man, "an arm that was never commanded stands still by itself"
    velocity = np.array([0.5, -0.2, 0.1, 0, 0, 0.3])
    for _ in range(100):
        world.step({"PSM1": ArmCommand(velocity=velocity)})
    for _ in range(20):
        world.step({})
    assert not link.dead_man
    assert world.state("PSM1").qd[0] == pytest.approx(0.5, rel=0.01)
    world.step({})
    assert link.dead_man
    fastest, previous = 0.0, world.state("PSM1").qd
    for _ in range(150):
        world.step({})
        qd = world.state("PSM1").qd
        fastest = max(fastest, float(np.max(np.abs(qd - previous) / TICK)))
        previous = qd
    print(f"stop at up to {fastest:.1f} rad/s^2")
    assert np.abs(previous).max() < 1e-3
    assert fastest <= ur5e.arms["PSM1"].robot.acceleration.max() * 1.2
    world.step({"PSM1": ArmCommand(velocity=velocity)})
    assert not link.dead_man


def test_jaw_moves_at_its_rate_and_is_shown(ur5e: surg_core.Cell) -> None:
    world = World(ur5e)
    instrument = ur5e.arms["PSM1"].instrument
    goal = instrument.jaw_max
    angles = []
    for _ in range(400):
        world.step({"PSM1": ArmCommand(velocity=np.zeros(6), jaw=goal + 1.0)})
        angles.append(world.state("PSM1").jaw)
    steps = np.diff([instrument.jaw_min, *angles])
    assert steps.max() <= instrument.jaw_velocity * TICK + 1e-12
    assert angles[-1] == pytest.approx(goal)
    shown = world.data.qpos[world.model.joint("PSM1_jaw").qposadr[0]]
    assert shown == pytest.approx(goal, abs=0.01)
    world.step({"PSM1": ArmCommand(velocity=np.zeros(6), jaw=float("nan"))})
    world.step({"PSM1": ArmCommand(velocity=np.zeros(6))})
    assert world.state("PSM1").jaw == pytest.approx(goal), "silence never moves the jaw"


def test_trocar_force_and_displacement(cell: surg_core.Cell) -> None:
    """Move the shaft sideways: the wall follows, pulled in this direction with its stiffness."""
    parameters = TrocarParameters(friction=0.0)
    world = World(cell, trocar=parameters)
    arm = cell.arms["PSM1"]
    _, s_F = shaft_in_flange(arm)
    s = arm.chain.forward(arm.robot.home)[:3, :3] @ s_F
    side = np.cross(s, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    for _ in range(250):
        world.step({"PSM1": ArmCommand(twist=np.array([*(0.01 * side), 0, 0, 0]))})
    for _ in range(500):
        world.step({"PSM1": ArmCommand(twist=np.zeros(6))})
    truth = world.truth("PSM1")
    print(f"deviation {truth.deviation * 1000:.3f} mm, force {truth.trocar_force}")
    assert truth.displacement == pytest.approx(truth.trocar_loaded - truth.trocar)
    assert truth.displacement @ side == pytest.approx(truth.deviation, rel=0.01)
    assert truth.deviation == pytest.approx(0.005, rel=0.05)
    assert truth.trocar_force @ side == pytest.approx(
        parameters.stiffness * truth.displacement @ side, rel=0.01
    )
    along = truth.trocar_force @ truth.shaft_axis
    assert abs(along) < 0.02, "no friction, no force along the shaft"


def test_seal_friction_pulls_along_the_shaft(ur5e: surg_core.Cell) -> None:
    arm = ur5e.arms["PSM1"]
    _, s_F = shaft_in_flange(arm)
    s = arm.chain.forward(arm.robot.home)[:3, :3] @ s_F
    friction = 2.0
    world = World(ur5e, trocar=TrocarParameters(friction=friction))
    for sign in (1.0, -1.0):
        world.reset()
        for _ in range(500):
            world.step({"PSM1": ArmCommand(twist=np.array([*(sign * 0.02 * s), 0, 0, 0]))})
        truth = world.truth("PSM1")
        assert truth.trocar_force @ s == pytest.approx(sign * friction, rel=0.05)


def test_truth_is_in_the_base_frame(ur5e: surg_core.Cell) -> None:
    """The same motion of an arm that stands elsewhere reads the same."""
    arm = ur5e.arms["PSM1"]
    X_WB = surg_core.make_pose([1.0, -2.0, 0.3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    moved = replace(ur5e, arms={"PSM1": replace(arm, X_WB=X_WB, X_WB_stated=X_WB)})
    here, there = World(ur5e), World(moved)
    velocity = np.array([0.05, 0.02, -0.03, 0.04, 0.01, 0.1])
    for _ in range(200):
        for world in (here, there):
            world.step({"PSM1": ArmCommand(velocity=velocity)})
    a, b = here.truth("PSM1"), there.truth("PSM1")
    for name in ("tip", "shaft_axis", "tip_velocity", "trocar", "trocar_loaded"):
        assert getattr(a, name) == pytest.approx(getattr(b, name), abs=1e-6), name
    assert a.trocar_force == pytest.approx(b.trocar_force, abs=1e-3)
    X = arm.chain.forward(here.state("PSM1").q)
    p_FTip, _ = shaft_in_flange(arm)
    assert a.tip == pytest.approx(X[:3, :3] @ p_FTip + X[:3, 3], abs=1e-9)


def test_tip_velocity_is_the_derivative_of_the_tip(ur5e: surg_core.Cell) -> None:
    world = World(ur5e)
    velocity = np.array([0.1, 0.05, -0.08, 0.2, 0.1, 0.4])
    for _ in range(100):
        world.step({"PSM1": ArmCommand(velocity=velocity)})
    before = world.truth("PSM1")
    world.step({"PSM1": ArmCommand(velocity=velocity)})
    after = world.truth("PSM1")
    difference = (after.tip - before.tip) / TICK
    assert difference == pytest.approx((after.tip_velocity + before.tip_velocity) / 2, abs=1e-4)


def test_the_hash_names_the_run(ur5e: surg_core.Cell) -> None:
    def run(world: World, scale: float) -> str:
        world.reset()
        for k in range(300):
            velocity = scale * 0.1 * np.sin(0.02 * k) * np.array([1, 0.5, -0.5, 0.7, 1, 2])
            world.step({"PSM1": ArmCommand(velocity=velocity, jaw=0.2)})
        return world.hash

    world = World(ur5e)
    first = run(world, 1.0)
    assert run(world, 1.0) == first, "a reset leaves something behind"
    assert run(World(ur5e), 1.0) == first
    assert run(World(ur5e, visuals=True), 1.0) == first, "pictures change the physics"
    assert run(World(ur5e), 1.0 + 1e-9) != first


def test_an_unknown_arm_is_named(ur5e: surg_core.Cell) -> None:
    with pytest.raises(ValueError, match=r"PSM7.*sim_ur5e.*PSM1"):
        World(ur5e, arms=["PSM7"])
