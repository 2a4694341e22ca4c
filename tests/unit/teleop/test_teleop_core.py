"""One hand on one arm: states, what each engagement begins with, what ends it, and what is said."""

import itertools
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.control.gate_arm import TICK, US, GateArm
from helpers.teleop.hand import Hand, settings
from surg_core.arm_view import ArmState
from surg_teleop.follow.teleop_types import (
    ABANDONED,
    REQUEST_LIFETIME,
    SILENCE,
    CameraView,
    ControlMode,
    Reason,
    TeleopOutput,
    TeleopState,
)
from surg_teleop.follow.teleoperation import Teleop

R_WV = Rotation.from_euler("xyz", [2.4, 0.3, -1.1]).as_matrix()


@dataclass
class Bench:
    """A hand, an arm and what is between them."""

    teleop: Teleop = field(default_factory=lambda: Teleop(settings(), scale=0.5))
    hand: Hand = field(default_factory=Hand)
    arm: GateArm = field(default_factory=GateArm)
    R_WV: np.ndarray = field(default_factory=lambda: R_WV)
    camera_at: float | None = None  # None: the camera is always fresh
    moved: str = ""
    log: list[TeleopOutput] = field(default_factory=list)

    def tick(self, n: int = 1, step: np.ndarray | None = None) -> TeleopOutput:
        """N cycles; the hand moves by ``step`` [m] in each."""
        for _ in range(n):
            if step is not None:
                self.hand.move(step)
            now = self.now
            heard = now if self.camera_at is None else self.camera_at
            camera = CameraView(self.R_WV, heard, self.moved)
            out = self.teleop.tick(now, self.hand.sample(now), self.arm.view(), camera)
            self.log.append(out)
            self.arm.step(out.commands)
        return self.log[-1]

    @property
    def now(self) -> float:
        return self.arm.tick * TICK

    def engaged(self) -> "Bench":
        """After enable, following."""
        self.tick(2)
        self.teleop.enable()
        assert self.tick(2).state is TeleopState.FOLLOWING, self.log[-1].message
        return self


def test_enable_homes_and_enables_the_arm_then_follows() -> None:
    bench = Bench(arm=GateArm(state=ArmState.DISABLED, homed=False))
    assert bench.tick(500).state is TeleopState.DISABLED
    assert all(out.commands.state is None for out in bench.log)
    bench.teleop.enable()
    out = bench.tick(400)
    assert out.state is TeleopState.FOLLOWING
    asked = [o.commands.state for o in bench.log if o.commands.state]
    assert asked == ["home", "enable"]
    assert bench.arm.holder == US
    assert bench.arm.refusals == []


def test_a_paused_arm_is_resumed_by_enable_and_by_nothing_else() -> None:
    bench = Bench().engaged()
    bench.arm.leave(ArmState.PAUSED, "force")
    out = bench.tick(100)
    assert out.state is TeleopState.WAITING
    assert out.reason is Reason.ARM_NOT_READY
    assert "PAUSED (force)" in out.message
    bench.hand.buttons = {"clutch"}
    bench.tick(5)
    bench.hand.buttons = set()
    assert bench.tick(4000).state is TeleopState.WAITING
    assert bench.arm.state == ArmState.PAUSED
    bench.teleop.enable()
    assert bench.tick(400).state is TeleopState.FOLLOWING


@pytest.mark.parametrize("state", [ArmState.PAUSED, ArmState.FAULT])
def test_enable_makes_the_arm_ready_once(state: ArmState) -> None:
    """Who pauses it afterwards, and a fault, is obeyed, though nothing has engaged yet."""
    bench = Bench(arm=GateArm(state=ArmState.PAUSED))
    bench.hand.buttons = {"clutch"}  # as an endoscope's hand nearly always is
    bench.teleop.enable()
    assert bench.tick(150).state is TeleopState.CLUTCHED
    bench.arm.leave(state, "operator")
    bench.tick(2000)
    assert bench.arm.state == state
    assert bench.log[-1].state is (
        TeleopState.FAULT if state == ArmState.FAULT else TeleopState.WAITING
    )
    assert [o.commands.state for o in bench.log if o.commands.state] == ["resume"]


def test_enable_right_after_disable_makes_the_arm_ready() -> None:
    """The arm has not been told to pause yet, and still says ENABLED."""
    bench = Bench().engaged()
    bench.teleop.disable()
    bench.tick()
    bench.arm.state = ArmState.ENABLED
    bench.teleop.enable()
    bench.tick(40)
    bench.arm.leave(ArmState.PAUSED, "operator")
    assert bench.tick(400).state is TeleopState.FOLLOWING


def test_the_first_command_of_an_engagement_is_the_set_point() -> None:
    bench = Bench(arm=GateArm(p=np.array([0.02, -0.03, 0.1]), roll=1.3, jaw=0.4))
    bench.engaged()
    first = next(out for out in bench.log if out.commands.servo_cp is not None)
    assert first.commands.claim
    assert np.array_equal(first.commands.servo_cp.p, [0.02, -0.03, 0.1])
    assert first.commands.jaw is None


def test_the_jaw_is_the_hands_from_its_first_touch_on() -> None:
    """Keys and sticks have no grip before; the touch itself opens nothing."""
    bench = Bench(arm=GateArm(jaw=0.4))
    bench.hand.grip = None
    bench.engaged().tick(100)
    bench.hand.grip = 1.0
    bench.tick(100)
    assert all(out.commands.jaw is None for out in bench.log)
    for grip in np.linspace(1.0, 0.2, 200):
        bench.hand.grip = float(grip)
        bench.tick()
    bench.tick(200)
    assert bench.arm.jaw == pytest.approx(0.14)
    for grip in (None, 1.0):  # touched anew: it is a new grip
        bench.hand.grip = grip
        bench.tick(50)
    assert bench.arm.jaw == pytest.approx(0.14)


def test_hand_and_tip_move_alike_in_the_picture() -> None:
    bench = Bench().engaged()
    bench.arm.R_WR = Rotation.from_rotvec([0.4, -1.2, 0.5]).as_matrix()
    for axis in np.eye(3):
        before = bench.arm.p
        bench.tick(100, 1e-4 * axis)
        bench.tick(100)
        moved_V = bench.R_WV.T @ bench.arm.R_WR @ (bench.arm.p - before)
        assert moved_V == pytest.approx(0.5 * 0.01 * axis, abs=1e-9)


def test_a_turn_of_the_hand_rolls_the_shaft_and_pitch_and_yaw_do_not() -> None:
    bench = Bench().engaged()
    for _ in range(200):
        bench.hand.turn(np.array([0.0, 0.0, 0.004]))
        bench.tick()
    bench.tick(100)
    assert bench.arm.roll == pytest.approx(0.8, abs=1e-9)
    for _ in range(200):
        bench.hand.turn(0.003 * bench.hand.R[:, 0])  # pitch of the handle about its own axis
        bench.tick()
    bench.tick(100)
    assert bench.arm.roll == pytest.approx(0.8, abs=1e-9)


def test_a_fast_wrist_is_followed_at_the_fastest_pace_and_not_cut() -> None:
    bench = Bench().engaged()
    for _ in range(100):  # 6 rad/s for 0.2 s: three times what the shaft may
        bench.hand.turn(np.array([0.0, 0.0, 0.012]))
        bench.tick()
    assert bench.arm.refusals == []
    bench.tick(600)
    assert bench.arm.roll == pytest.approx(1.2, abs=1e-9)


def test_clutch_stops_and_lets_the_hand_go_elsewhere() -> None:
    bench = Bench().engaged()
    bench.tick(50, np.array([2e-4, 0.0, 0.0]))
    bench.hand.buttons = {"clutch"}
    assert bench.tick().commands.hold
    assert bench.log[-1].state is TeleopState.CLUTCHED
    before, sent = bench.arm.p, len(bench.log)
    bench.tick(300, np.array([1e-3, -1e-3, 0.0]))
    assert np.array_equal(bench.arm.p, before)
    assert all(out.commands.servo_cp is None for out in bench.log[sent:])
    bench.hand.buttons = set()
    bench.tick(100)
    assert bench.log[-1].state is TeleopState.FOLLOWING
    assert np.array_equal(bench.arm.p, before)
    assert bench.arm.refusals == []


def test_a_quick_tap_of_the_clutch_waits_until_the_arm_may_start_again() -> None:
    bench = Bench().engaged()
    bench.hand.buttons = {"clutch"}
    bench.tick()
    bench.hand.buttons = set()
    assert bench.tick().state is TeleopState.CLUTCHED
    assert bench.log[-1].reason is Reason.ARM_STOPPING
    assert bench.tick(80).state is TeleopState.FOLLOWING
    assert bench.arm.refusals == []


def test_f03_a_silent_leader_holds_within_its_limit_and_needs_an_act() -> None:
    bench = Bench().engaged()
    bench.tick(50, np.array([1e-4, 0.0, 0.0]))
    bench.hand.speaks = False
    silent_since = bench.log[-1]
    assert silent_since.state is TeleopState.FOLLOWING
    ticks = 0
    while bench.tick().state is TeleopState.FOLLOWING:
        ticks += 1
    assert ticks == round(SILENCE / TICK)  # the 51st tick holds
    assert bench.log[-1].commands.hold
    assert bench.log[-1].reason is Reason.LEADER_SILENT
    bench.hand.move(np.array([0.2, 0.0, 0.0]))  # it was carried elsewhere meanwhile
    bench.hand.speaks = True
    before = bench.arm.p
    assert bench.tick(1000).state is TeleopState.WAITING
    assert bench.log[-1].reason is Reason.NOT_REQUESTED
    assert np.array_equal(bench.arm.p, before)


def test_f03_a_leader_that_left_pauses_the_arm() -> None:
    bench = Bench().engaged()
    bench.hand.speaks = False
    bench.tick(round(ABANDONED / TICK))
    assert bench.arm.state == ArmState.ENABLED
    bench.tick(5)
    assert bench.arm.state == ArmState.PAUSED
    assert bench.arm.holder == ""  # free for a policy: F30
    assert [o.commands.state for o in bench.log if o.commands.state] == ["pause"]


def test_f03_buttons_that_changed_during_a_silence_are_no_act() -> None:
    """A pedal that was pressed when the device was unplugged, and is up when it is plugged in."""
    bench = Bench().engaged()
    bench.hand.buttons = {"clutch"}
    bench.tick(10)
    bench.hand.speaks = False
    bench.tick(100)
    bench.hand.speaks, bench.hand.buttons = True, set()
    assert bench.tick(2000).state is TeleopState.WAITING
    assert bench.teleop.engagements == 1


@pytest.mark.parametrize("act", ["enable", "clutch"])
def test_f03_what_was_asked_for_before_the_hand_came_back_does_not_engage(act: str) -> None:
    """Enabled beside a silent hand the arm gets ready, and follows after the next act only."""
    bench = Bench().engaged()
    if act == "clutch":
        bench.hand.buttons = {"clutch"}
        bench.tick(10)
        bench.arm.leave(ArmState.PAUSED, "force")  # what keeps it from engaging at once
        bench.hand.buttons = set()
        bench.tick(2)
    bench.hand.speaks = False
    bench.tick(round(2 * SILENCE / TICK))
    bench.teleop.enable() if act == "enable" else bench.arm.leave(ArmState.ENABLED, "")
    bench.tick(2)
    bench.hand.speaks = True
    assert bench.tick(round(REQUEST_LIFETIME / TICK)).state is TeleopState.WAITING
    assert bench.arm.state == ArmState.ENABLED
    assert bench.teleop.engagements == 1
    bench.teleop.enable()
    assert bench.tick(2).state is TeleopState.FOLLOWING


def test_f27_a_node_that_was_frozen_does_not_go_on() -> None:
    bench = Bench().engaged()
    bench.arm.tick += 1000  # two seconds in which this node did not run
    bench.hand.move(np.array([0.05, 0.0, 0.0]))
    out = bench.tick()
    assert out.state is TeleopState.WAITING
    assert out.commands.hold
    assert out.commands.servo_cp is None
    assert out.reason is Reason.NODE_STALLED
    assert bench.tick(2000).state is TeleopState.WAITING


def test_f26_f30_an_arm_that_another_holds_is_left_to_it() -> None:
    bench = Bench(arm=GateArm(holder="/policy"))
    bench.teleop.enable()
    out = bench.tick(200)
    assert out.state is TeleopState.WAITING
    assert out.reason is Reason.ARM_HELD
    assert out.message == "PSM1 is held by /policy; pause PSM1, then press enable"
    assert all(o.commands.servo_cp is None and not o.commands.claim for o in bench.log)
    bench.arm.leave(ArmState.PAUSED, "operator")
    bench.arm.state = ArmState.ENABLED
    bench.arm.holder = ""
    assert bench.tick(5).state is TeleopState.FOLLOWING  # within the time that enable counts


def test_f26_authority_lost_is_not_fought_for() -> None:
    bench = Bench().engaged()
    bench.arm.holder = "/stranger"
    out = bench.tick()
    assert out.state is TeleopState.WAITING
    assert out.reason is Reason.ARM_HELD
    bench.arm.holder = ""
    assert bench.tick(1000).state is TeleopState.WAITING


@pytest.mark.parametrize("reason", ["rcm_error", "link"])
def test_a_fault_of_the_arm_is_latched(reason: str) -> None:
    bench = Bench().engaged()
    bench.arm.leave(ArmState.FAULT, reason)
    out = bench.tick()
    assert out.state is TeleopState.FAULT
    assert reason in out.message
    bench.arm.state = ArmState.ENABLED  # somebody else enabled it
    assert bench.tick(1000).state is TeleopState.FAULT
    bench.teleop.enable()
    assert bench.tick(400).state is TeleopState.FOLLOWING


def test_a_pose_that_is_not_a_number_is_a_fault_with_the_device_named() -> None:
    bench = Bench().engaged()
    bench.hand.broken = True
    out = bench.tick()
    assert out.state is TeleopState.FAULT
    assert out.commands.hold
    assert out.reason is Reason.LEADER_INVALID
    assert out.message.startswith("hand ")
    bench.hand.broken = False
    assert bench.tick(500).state is TeleopState.FAULT


@pytest.mark.parametrize("says", [[0, 0, 0, 1.01], [0, 0, 0, 0], [0, 0, 1], np.eye(3)])
def test_a_pose_that_is_no_rotation_is_a_fault(says: Any) -> None:
    bench = Bench().engaged()
    bench.hand.says = np.array(says, dtype=float)
    out = bench.tick()
    assert out.state is TeleopState.FAULT
    assert "no unit quaternion x, y, z, w" in out.message


def test_a_leader_that_says_it_is_not_ready_is_not_followed() -> None:
    bench = Bench().engaged()
    bench.hand.problem = "is PAUSED: enable it"
    out = bench.tick()
    assert (out.state, out.message) == (TeleopState.WAITING, "hand: is PAUSED: enable it")


@pytest.mark.parametrize("step", [np.array([0.0, 0.02, 0.0]), np.array([0.0, 0.0, 0.5])])
def test_a_hand_that_jumps_is_refused_and_clutched(step: np.ndarray) -> None:
    bench = Bench().engaged()
    before = bench.arm.p
    out = bench.tick(1, step)
    assert out.state is TeleopState.CLUTCHED
    assert out.commands.hold
    assert out.reason is Reason.HAND_JUMP
    assert bench.tick(1000).state is TeleopState.CLUTCHED
    assert np.linalg.norm(bench.arm.p - before) < 1e-12
    bench.hand.buttons = {"clutch"}
    bench.tick(5)
    bench.hand.buttons = set()
    assert bench.tick(100).state is TeleopState.FOLLOWING


def test_an_arm_that_cannot_keep_up_is_let_go() -> None:
    bench = Bench(teleop=Teleop(settings(), scale=1.0)).engaged()
    bench.arm.stuck = True
    out = bench.tick(200, np.array([3e-4, 0.0, 0.0]))
    assert out.state is TeleopState.CLUTCHED
    assert out.reason is Reason.LAGGING


def test_an_arm_that_does_not_obey_is_let_go() -> None:
    bench = Bench().engaged()
    bench.tick(200)
    bench.arm.goal, bench.arm.held = None, 0.0  # somebody sent hold
    bench.arm.reason = "held"
    out = bench.tick()
    assert out.state is TeleopState.CLUTCHED
    assert out.reason is Reason.NOT_OBEYING
    assert "(held)" in out.message


def test_a_wall_holds_the_target_and_says_so() -> None:
    bench = Bench(teleop=Teleop(settings(), scale=1.0)).engaged()
    away = bench.arm.R_WR.T @ np.array([0.0, 0.0, 4e-4])
    out = bench.tick(600, bench.R_WV.T @ away)
    assert out.state is TeleopState.FOLLOWING
    assert out.reason is Reason.AT_LIMIT
    assert "depth_max" in out.message
    assert np.linalg.norm(bench.arm.p) == pytest.approx(0.220, abs=2e-4)
    # Back at once: what the hand went beyond the wall is not stored.
    out = bench.tick(10, bench.R_WV.T @ -away)
    assert out.message == ""
    assert np.linalg.norm(bench.arm.p) < 0.218
    assert bench.arm.refusals == []


def test_scale_and_locks_and_camera_change_without_a_step() -> None:
    bench = Bench().engaged()
    bench.tick(100, np.array([1e-4, 0.0, 0.0]))
    bench.tick(50)
    before = bench.arm.p
    assert bench.teleop.set_scale(1.0) == ""
    bench.tick(50)
    bench.R_WV = Rotation.from_rotvec([0.0, 1.0, 0.0]).as_matrix() @ bench.R_WV
    bench.tick(50)
    bench.teleop.lock_translation = True
    bench.tick(50, np.array([3e-4, 0.0, 0.0]))
    bench.teleop.lock_translation = False
    bench.tick(50)
    assert np.array_equal(bench.arm.p, before)
    assert "allowed: 0.01 to 1" in bench.teleop.set_scale(math.nan)
    assert bench.teleop.scale == 1.0


def test_rotation_lock_keeps_the_roll() -> None:
    bench = Bench().engaged()
    bench.hand.buttons = {"lock_rotation"}
    for _ in range(100):
        bench.hand.turn(np.array([0.0, 0.0, 0.004]))
        bench.tick(1, np.array([1e-4, 0.0, 0.0]))
    bench.tick(50)
    assert bench.arm.roll == 0.0
    assert np.linalg.norm(bench.arm.p - [0.0, 0.0, 0.12]) == pytest.approx(0.005, abs=1e-9)


def test_rate_mapping_moves_in_the_picture_and_stops_with_the_stick() -> None:
    bench = Bench(teleop=Teleop(settings(mode=ControlMode.RATE))).engaged()
    bench.hand.v = np.array([0.02, 0.0, 0.0])
    before = bench.arm.p
    bench.tick(500)
    bench.hand.v = np.zeros(3)
    bench.tick(100)
    assert bench.R_WV.T @ (bench.arm.p - before) == pytest.approx([0.02, 0, 0], abs=1e-9)
    assert bench.arm.refusals == []


def test_spherical_rates_turn_about_the_trocar() -> None:
    bench = Bench(teleop=Teleop(settings(mode=ControlMode.RATE))).engaged()
    bench.hand.spherical, bench.hand.roll_rate = np.array([0.1, 0.0, 0.01]), -0.2
    bench.tick(500)
    bench.hand.spherical, bench.hand.roll_rate = np.zeros(3), 0.0
    bench.tick(100)
    x, y, z = bench.arm.p
    assert [math.atan2(x, z), y] == pytest.approx([0.1, 0.0], abs=1e-9)
    assert np.linalg.norm(bench.arm.p) == pytest.approx(0.13, abs=1e-9)
    assert bench.arm.roll == pytest.approx(-0.2, abs=1e-9)


def test_a_stick_that_is_deflected_cannot_engage() -> None:
    bench = Bench(teleop=Teleop(settings(mode=ControlMode.RATE)))
    bench.hand.v = np.array([0.02, 0.0, 0.0])
    bench.teleop.enable()
    out = bench.tick(100)
    assert (out.state, out.reason) == (TeleopState.WAITING, Reason.LEADER_DEFLECTED)
    bench.hand.v = np.zeros(3)
    assert bench.tick(2).state is TeleopState.FOLLOWING


def test_a_stick_does_not_run_ahead_of_an_arm_that_is_held_back() -> None:
    bench = Bench(teleop=Teleop(settings(mode=ControlMode.RATE))).engaged()
    bench.arm.stuck = True
    bench.hand.v = np.array([0.1, 0.0, 0.0])
    assert bench.tick(1000).state is TeleopState.FOLLOWING
    last = [o.commands.servo_cp.p for o in bench.log if o.commands.servo_cp is not None][-1]
    assert np.linalg.norm(last - bench.arm.p) <= 0.02 + 1e-9


def test_the_mapping_changes_while_clutched_only() -> None:
    bench = Bench().engaged()
    bench.hand.buttons = {"rate"}
    bench.tick()
    assert bench.teleop.mode is ControlMode.POSITION
    bench.hand.buttons = {"clutch"}
    bench.tick()
    bench.hand.buttons = {"clutch", "rate"}
    bench.tick()
    assert bench.teleop.mode is ControlMode.RATE


def test_a_mapping_that_was_asked_for_waits_for_the_clutch_and_is_asked_for_once() -> None:
    bench = Bench().engaged()
    bench.teleop.set_mode(ControlMode.RATE)
    bench.tick(100)
    assert bench.teleop.mode is ControlMode.POSITION
    bench.hand.buttons = {"clutch"}
    bench.tick(2)
    assert bench.teleop.mode is ControlMode.RATE
    bench.hand.buttons = {"clutch", "rate"}
    bench.tick(10)
    assert bench.teleop.mode is ControlMode.POSITION  # the button counts, not the earlier request


def test_a_mapping_that_was_asked_for_is_forgotten_when_the_arm_is_disabled() -> None:
    bench = Bench().engaged()
    bench.teleop.set_mode(ControlMode.RATE)
    bench.teleop.disable()
    bench.tick()
    bench.teleop.enable()
    bench.hand.buttons = {"clutch"}
    bench.tick(100)
    assert bench.teleop.mode is ControlMode.POSITION


@pytest.mark.parametrize("only", ControlMode)
@pytest.mark.parametrize("began", ControlMode)
def test_a_hand_with_one_mapping_keeps_it(only: ControlMode, began: ControlMode) -> None:
    """The button may be a pedal beside another hand; it only ever brings the one that there is."""
    bench = Bench(teleop=Teleop(settings(mode=began)))
    bench.hand.offers = frozenset({only})
    bench.hand.buttons = {"clutch"}
    bench.teleop.enable()
    bench.tick()
    for _ in range(2):
        bench.hand.buttons = {"clutch", "rate"}
        bench.tick()
        assert bench.teleop.mode is only
        bench.hand.buttons = {"clutch"}
        bench.tick()
    bench.hand.buttons = set()
    assert bench.tick(100).state is TeleopState.FOLLOWING


def test_presence_is_needed_where_it_is_asked_for() -> None:
    bench = Bench(teleop=Teleop(settings(need_present=True)))
    bench.teleop.enable()
    assert bench.tick(100).reason is Reason.NOT_PRESENT
    bench.hand.buttons = {"present"}
    assert bench.tick(100).state is TeleopState.FOLLOWING
    bench.hand.buttons = set()
    out = bench.tick()
    assert out.state is TeleopState.WAITING
    assert out.commands.hold
    bench.tick(round(REQUEST_LIFETIME / TICK))
    bench.hand.buttons = {"present"}  # coming back is an act
    assert bench.tick(3).state is TeleopState.FOLLOWING


def test_an_act_does_not_count_for_ever() -> None:
    bench = Bench()
    bench.hand.speaks = False
    bench.teleop.enable()
    bench.tick(round(REQUEST_LIFETIME / TICK) + 2)
    bench.hand.speaks = True
    assert bench.tick(1000).state is TeleopState.WAITING


def test_a_camera_arm_that_is_silent_ends_following() -> None:
    bench = Bench().engaged()
    bench.camera_at = bench.now
    out = bench.tick(round(SILENCE / TICK) + 2)
    assert out.state is TeleopState.WAITING
    assert out.reason is Reason.CAMERA_SILENT


def test_in_a_view_that_moved_no_hand_begins_but_one_goes_on() -> None:
    bench = Bench().engaged()
    bench.moved = "the picture is not what was calibrated"
    assert bench.tick(50).state is TeleopState.FOLLOWING, "never in the middle of a motion"
    bench.hand.buttons = {"clutch"}
    bench.tick(50)
    bench.hand.buttons = set()
    out = bench.tick(50)
    assert (out.state, out.reason) == (TeleopState.CLUTCHED, Reason.CAMERA_MOVED)
    assert out.message == bench.moved


def test_a_tip_near_the_trocar_is_inserted_first() -> None:
    bench = Bench(arm=GateArm(p=np.array([0.0, 0.0, 0.018])))
    bench.teleop.enable()
    assert bench.tick(10).reason is Reason.TOO_SHALLOW
    assert "PSM1/rcm/insert" in bench.log[-1].message


@pytest.mark.parametrize("seed", range(20))
def test_a_tip_that_stopped_above_the_workspace_follows_the_hand_back_in(seed: int) -> None:
    """It brakes beyond 30 mm. Engaged again it rests, then goes deeper only, and stays below."""
    rng = np.random.default_rng(seed)
    aside, depth = rng.uniform(-0.4, 0.4), rng.uniform(0.0195, 0.0299)
    p = depth * np.array([math.sin(aside), 0.0, math.cos(aside)])
    bench = Bench(arm=GateArm(p=p, shallowest=0.0190), R_WV=np.eye(3)).engaged()
    bench.tick(100, np.zeros(3))
    assert np.abs(bench.arm.p - p).max() < 1e-9
    depths = [depth]
    for _ in range(200):
        bench.tick(5, 2e-4 * rng.normal(size=3) + [0.0, 0.0, 1e-4])
        depths.append(float(np.linalg.norm(bench.arm.p)))
    bench.tick(2000, np.array([0.0, 0.0, -1e-4]))
    depths.append(float(np.linalg.norm(bench.arm.p)))
    assert all(b > min(a, 0.030) - 1e-9 for a, b in itertools.pairwise(depths))
    assert max(depths) > 0.031 and bench.arm.refusals == []
    assert bench.log[-1].state is TeleopState.FOLLOWING


def test_disable_pauses_the_arm_and_frees_it() -> None:
    bench = Bench().engaged()
    bench.tick(20, np.array([1e-4, 0.0, 0.0]))
    bench.teleop.disable()
    out = bench.tick()
    assert (out.state, out.commands.hold, out.commands.state) == (
        TeleopState.DISABLED,
        True,
        "pause",
    )
    assert bench.arm.state == ArmState.PAUSED
    bench.tick(100, np.array([1e-3, 0.0, 0.0]))
    assert all(o.commands == o.commands.__class__(o.commands.stamp_ns) for o in bench.log[-100:])
