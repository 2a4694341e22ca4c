"""Clutch storms: random events in any order; and the same hand on the real controller.

``SURG_TEST_FULL=1`` runs 100,000 storms. A storm that fails is given by its seed; the property
test finds the shortest one.
"""

import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

import surg_core
from helpers.control.lagging_arm import SOURCE, TICK, LaggingArm
from helpers.results.teleoperation_results import STORMS as ROW
from helpers.results.teleoperation_results import note
from helpers.teleop.hand import Hand, settings
from helpers.teleop.storm import EVENTS, Event, Storm
from surg_cli.host import paths
from surg_core.arm_view import ArmCommands, ArmState
from surg_teleop.follow.target_pose import StepLimits
from surg_teleop.follow.teleop_types import CameraView, ControlMode, TeleopState
from surg_teleop.follow.teleoperation import Teleop
from surg_teleop.playback.workspace_fit import Workspace

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
STORMS = 100_000 if FULL else 150
EXAMPLES = 3_000 if FULL else 40
REAL = 200 if FULL else 4
LENGTH = 14
OFTEN = ("move_x", "move_y", "move_z", "roll", "grip", "clutch", "wait", "recover")
WEIGHTS = np.array([5.0 if name in OFTEN else 1.0 for name in EVENTS])


def random_events(rng: np.random.Generator, n: int = LENGTH) -> list[Event]:
    kinds = rng.choice(len(EVENTS), size=n, p=WEIGHTS / WEIGHTS.sum())
    values = rng.uniform(-1.0, 1.0, n)
    return [(EVENTS[k], v) for k, v in zip(kinds.tolist(), values.tolist(), strict=True)]


def test_storms_of_events_never_jump_and_never_open_the_jaw() -> None:
    ticks, engagements, largest = 0, 0, 0.0
    for seed in range(STORMS):
        rng = np.random.default_rng(seed)
        kind = ControlMode.RATE if seed % 3 == 0 else ControlMode.POSITION
        try:
            storm = Storm(kind, need_present=seed % 5 == 0).run(random_events(rng))
        except AssertionError as error:
            raise AssertionError(f"storm of seed {seed}, {kind.value}: {error}") from error
        ticks += storm.ticks
        engagements += storm.teleop.engagements
        largest = max(largest, storm.largest)
    said = f"{ticks} ticks, {engagements} engagements; largest step {largest:.2f} of the allowed"
    note(ROW, STORMS, said)
    assert engagements > 1.8 * STORMS  # they do engage again
    assert largest > 0.3  # and they do move


@hypothesis_settings(max_examples=EXAMPLES, deadline=None, database=None, derandomize=not FULL)
@given(
    events=st.lists(
        st.tuples(st.sampled_from(EVENTS), st.floats(-1.0, 1.0, allow_nan=False)), max_size=25
    ),
    kind=st.sampled_from(list(ControlMode)),
)
def test_no_sequence_of_events_breaks_a_rule(events: list[Event], kind: ControlMode) -> None:
    Storm(kind).run(events)


@pytest.mark.parametrize("kind", list(ControlMode))
def test_storms_on_the_real_controller(kind: ControlMode) -> None:
    """No refusal; tip and joints keep their limits in every cycle, whatever the hand does."""
    arm = surg_core.load_cell(paths.ROOT / "cells/sim_ur5e").arms["PSM1"]
    limits = arm.limits
    made = settings(
        mode=kind,
        workspace=Workspace(limits.depth_slow, limits.depth_max, limits.cone),
        step=StepLimits.of(limits),
    )
    joints = arm.robot
    engagements, fastest, swiftest, hardest = 0, 0.0, 0.0, 0.0
    for seed in range(REAL):
        rng = np.random.default_rng(1000 + seed)
        plant, hand = LaggingArm(arm), Hand()
        teleop = Teleop(made, scale=float(rng.uniform(0.2, 1)))
        plant.step(ArmCommands())
        commands = ArmCommands(state="home")
        teleop.enable()
        v, w, p, before, refused = np.zeros(3), 0.0, [], ArmState.DISABLED, 0
        qd = np.asarray(plant.out.qd_command)
        for k in range(1500):
            plant.step(commands)
            view = plant.view({SOURCE: "/teleop"})
            now = plant.tick * TICK
            if k % 25 == 0:  # another wish every 50 ms
                v = rng.normal(0.0, 0.15, 3) if rng.uniform() < 0.7 else np.zeros(3)
                w = rng.normal(0.0, 2.0)
                hand.v = v if teleop.state is TeleopState.FOLLOWING else np.zeros(3)
                hand.roll_rate = w if teleop.state is TeleopState.FOLLOWING else 0.0
                if rng.uniform() < 0.15:
                    hand.buttons ^= {"clutch"}
                if rng.uniform() < 0.03:
                    teleop.set_scale(float(rng.uniform(0.1, 1.0)))
                stranger = "pause" if rng.uniform() < 0.02 else None
                if rng.uniform() < 0.10:
                    teleop.enable()
            hand.move(v * TICK)
            hand.turn(w * TICK * hand.R[:, 2])
            out = teleop.tick(now, hand.sample(now), view, CameraView(np.eye(3)))
            commands = out.commands
            commands.state = stranger if k % 25 == 0 and stranger else commands.state
            if view.state == ArmState.ENABLED:  # else it was paused with a command on its way
                assert view.refused == refused, f"seed {seed}, tick {k}: {view.reason}"
            refused = view.refused
            # Entering ENABLED puts the set-point on the measured pose: that is no motion.
            if view.state == ArmState.ENABLED == before:
                p.append(view.p_set)
            else:
                p.clear()
            before = view.state
            if len(p) >= 2:
                fastest = max(fastest, float(np.abs(p[-1] - p[-2]).max()) / TICK)
            # What the robot is told: the set-point may fall back to a tip that joints cannot brake.
            qd_before, qd = qd, np.asarray(plant.out.qd_command)
            swiftest = max(swiftest, float((np.abs(qd) / joints.velocity).max()))
            change = np.abs(qd - qd_before) / TICK
            hardest = max(hardest, float((change / joints.acceleration).max()))
        engagements += teleop.engagements
    print(
        f"{kind.value}: {REAL} storms of 3 s, {engagements} engagements, set-point at most "
        f"{fastest:.3f} m/s per axis, joints at most {swiftest:.4f} of their velocities and "
        f"{hardest:.4f} of their accelerations"
    )
    assert engagements > 2 * REAL
    assert fastest <= limits.tip_velocity + 1e-9
    assert swiftest <= 1.0 + 1e-9
    assert hardest <= 1.0 + 1e-9
