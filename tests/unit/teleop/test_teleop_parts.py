"""What the teleoperation is made of: leaders, jaw, handle, walls, camera, seat, picture, system."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import surg_core
from helpers.control.gate_arm import TICK, GateArm
from helpers.teleop.hand import JAW, WORKSPACE, Hand, settings
from surg_cli.host import paths
from surg_core.arm_view import ArmCommands, ArmState, TipPose
from surg_core.contract import PRESENCE_TIMEOUT
from surg_core.transforms import virtual_tip
from surg_ros.params import ParamError
from surg_teleop.follow import camera_file
from surg_teleop.follow.arm_switch import ArmSwitch
from surg_teleop.follow.endoscope_pose import held_camera
from surg_teleop.follow.jaw_follower import MET, SLOW, JawFollower
from surg_teleop.follow.message_lateness import Arrivals
from surg_teleop.follow.pedal_monitor import PedalMonitor
from surg_teleop.follow.picture_watch import PictureWatch
from surg_teleop.follow.servo_instrument import ServoInstrument
from surg_teleop.follow.teleop_setup import REOPEN, read_setup
from surg_teleop.follow.teleop_setup import Hand as SeatedHand
from surg_teleop.follow.teleop_types import CameraView, State
from surg_teleop.follow.teleoperation import Teleop
from surg_teleop.leaders import leader as leaders
from surg_teleop.leaders.bundled.crtk import CrtkLeader
from surg_teleop.leaders.bundled.motion import MotionLeader
from surg_teleop.leaders.handle_roll import Handle
from surg_teleop.leaders.leader import HandlePose, LeaderError

TWO_ARMS = paths.ROOT / "cells/sim_two_arms"
BUNDLED = paths.ROOT / "src/surg_teleop/motions/bundled.csv"

# --- leaders


def test_bundled_leaders_are_found_and_an_unknown_one_names_them() -> None:
    assert {"motion", "crtk"} <= set(leaders.names())
    for name in leaders.names():
        assert hasattr(leaders.KIND.find(name), "read")
    with pytest.raises(LeaderError, match=r"glove: there is no such leader; there are crtk, "):
        leaders.load("glove", {})
    with pytest.raises(LeaderError, match=r"setting speed is unknown; allowed: name, rotation"):
        leaders.load("crtk", {"speed": 1.0})
    with pytest.raises(LeaderError, match=r"rate: 0.1; allowed: 1 to 1000 Hz"):
        leaders.load("motion", {"file": "x.csv", "rate": 0.1})


def test_a_leader_from_outside_the_tree_runs_by_path(tmp_path: Path) -> None:
    file = tmp_path / "my_leader.py"
    file.write_text(
        '''"""A leader that sits still."""
import numpy as np
from surg_teleop.leaders.leader import HandlePose, LeaderSample

class Still:
    def __init__(self, depth=0.1):
        self.name, self.depth = "still", depth
    def open(self):
        pass
    def read(self, now):
        return LeaderSample(now, HandlePose(np.array([0.0, 0.0, self.depth]), np.eye(3)))
    def close(self):
        pass
'''
    )
    found = leaders.load(str(file), {"depth": 0.2})
    assert isinstance(found, leaders.Leader)
    sample = found.read(3.0)
    assert sample is not None
    assert sample.finite()
    assert sample.pose.p_VH[2] == 0.2
    file.write_text("x = 1\n")
    with pytest.raises(LeaderError, match="defines 0 leaders; one public class"):
        leaders.load(str(file), {})
    file.write_text("1 / 0\n")
    with pytest.raises(LeaderError, match="ZeroDivisionError"):
        leaders.load(str(file), {})


def test_a_motion_file_is_a_hand_that_rests_plays_and_rests() -> None:
    leader = MotionLeader(str(BUNDLED), rate=30.0, delay=1.0, rotation=(0.0, 0.0, math.pi / 2))
    assert leader.read(0.0) is None
    leader.open()
    samples = [leader.read(10.0 + k * TICK) for k in range(2000)]
    stamps = np.unique([s.stamp for s in samples])
    assert np.diff(stamps) == pytest.approx(1.0 / 30.0)
    assert all(s.stamp <= 10.0 + k * TICK + 1e-6 for k, s in enumerate(samples))
    assert np.array_equal(samples[0].pose.p_VH, samples[490].pose.p_VH)
    x, y, _ = samples[0].pose.p_VH
    raw = leader._spline(0.0)
    assert [y, -x] == pytest.approx(raw[:2])  # turned by 90 degrees
    assert not np.array_equal(samples[490].pose.p_VH, samples[1999].pose.p_VH)
    assert all(s.finite() and 0.0 <= s.grip <= 1.0 for s in samples)
    last = leader.read(10.0 + 3600.0)
    assert last.stamp == pytest.approx(3610.0, abs=0.04)
    leader.close()
    assert leader.read(3611.0) is None
    with pytest.raises(LeaderError, match=r"motion: .*cannot be read"):
        MotionLeader("/nowhere.csv").open()


class Faulty(CrtkLeader):
    """Somebody's own, with a mistake in it."""

    def __init__(self) -> None:
        self.name, self.opened = "faulty", 0

    def open(self) -> None:
        self.opened += 1

    def read(self, now: float) -> None:
        raise ZeroDivisionError("division by zero")

    def close(self) -> None:
        raise AttributeError("device")


def test_a_leader_that_raises_whatever_it_likes_is_a_leader_that_is_lost() -> None:
    """So the arm is held and paused, and the node ends as it should."""
    leader = Faulty()
    hand = SeatedHand(leader, ArmSwitch(Teleop(settings())))
    for now in (0.0, 0.5 * REOPEN, 1.1 * REOPEN):
        assert hand.read(now) is None
        assert hand.problem == "ZeroDivisionError: division by zero"
    assert leader.opened == 2


def test_a_crtk_leader_is_what_its_topics_say() -> None:
    leader = CrtkLeader("MTMR", rotation=(math.pi, 0.0, 0.0), grip_closed=-0.1, grip_open=0.9)
    leader.open()
    one = np.array([0.0, 0.0, 0.0, 1.0])
    assert leader.read(0.0) is None
    leader.on_pose(1.0, np.array([0.1, 0.2, 0.3]), one)
    leader.on_grip(1.0, 0.4)
    sample = leader.read(5.0)
    assert sample.stamp == 1.0  # an old pose stays old
    assert sample.pose.p_VH == pytest.approx([0.1, -0.2, -0.3])
    assert sample.grip == pytest.approx(0.5)
    leader.on_pose(6.0, np.zeros(3), one, valid=False)
    assert leader.read(6.0).stamp == 1.0
    leader.on_pose(7.0, np.zeros(3), np.array([0.0, 0.0, 0.0, 0.5]))
    assert not leader.read(7.0).finite()
    leader.on_rate(8.0, np.array([0.0, 0.01, 0.0]), np.array([0.0, 0.0, 0.2]))
    sample = leader.read(8.0)
    assert sample.pose is None  # a second old
    assert sample.rate.v_V == pytest.approx([0.0, -0.01, 0.0])
    assert sample.rate.roll == pytest.approx(-0.2)
    leader.on_state("PAUSED")
    assert leader.read(8.0).problem == "is PAUSED: enable it, then press the clutch or enable"


def test_a_grip_ends_with_a_silence_of_its_hand_and_not_before() -> None:
    """Behind one name another may sit by then; a device may say its grip only when it changes."""
    leader = CrtkLeader()
    one = np.array([0.0, 0.0, 0.0, 1.0])
    leader.on_pose(0.0, np.zeros(3), one)
    leader.on_grip(0.0, 0.2)
    for tick in range(1, 101):
        leader.on_pose(0.02 * tick, np.zeros(3), one)
    assert leader.read(2.0).grip == pytest.approx(0.2)
    leader.on_rate(2.5, np.zeros(3), np.zeros(3))
    assert leader.read(2.5).grip is None
    leader.on_grip(3.0, 0.3)  # topics overtake each other
    leader.on_pose(3.001, np.zeros(3), one)
    assert leader.read(3.001).grip == pytest.approx(0.3)


# --- jaw


def test_f31_an_engagement_never_opens_the_jaw() -> None:
    ghost = JawFollower(JAW, 3.0, angle=0.1, grip=0.8)
    assert [ghost.tick(0.8, 0.002) for _ in range(1000)] == [0.1] * 1000
    # The hand opens by a tenth of its range: so does the jaw, slowly.
    angles = [ghost.tick(0.9, 0.002) for _ in range(1000)]
    assert angles[0] == pytest.approx(0.1 + SLOW * 0.002)
    assert angles[-1] == pytest.approx(0.1 + 0.07)
    # It closes towards the jaw until both have met, and leads it fast from then on.
    ghost.tick(0.1, 0.002)
    assert not ghost.met
    while not ghost.met:
        ghost.tick(0.1, 0.002)
    assert abs(ghost.angle - 0.07) <= MET
    before = ghost.angle
    assert ghost.tick(1.0, 0.002) == pytest.approx(before + 0.006)


def test_f31_what_the_hand_opened_and_closed_again_opens_nothing() -> None:
    ghost = JawFollower(JAW, 3.0, angle=0.0, grip=0.5)
    ghost.tick(1.0, 0.0)
    ghost.tick(0.5, 0.0)
    assert [ghost.tick(0.5, 0.002) for _ in range(100)] == [0.0] * 100


def test_f31_random_grips_never_open_more_than_the_hand() -> None:
    rng = np.random.default_rng(7)
    for _ in range(200):
        grips = np.clip(np.cumsum(rng.normal(0.0, 0.1, 100)) + rng.uniform(), 0.0, 1.0)
        ghost = JawFollower(JAW, 3.0, angle=rng.uniform(0.0, 0.7), grip=grips[0])
        by_hand, by_jaw, before, angle = 0.0, 0.0, grips[0], ghost.angle
        for grip in grips:
            by_hand += 0.7 * max(0.0, grip - before)
            after = ghost.tick(grip, rng.uniform(0.0, 0.05))
            by_jaw += max(0.0, after - angle)
            before, angle = grip, after
            assert by_jaw <= by_hand + 1e-12


# --- handle


def test_roll_is_the_twist_of_swing_and_twist() -> None:
    """Any swing times a known twist, against SciPy's quaternions."""
    rng = np.random.default_rng(3)
    for _ in range(300):
        R_0 = Rotation.random(random_state=rng.integers(2**31))
        handle = Handle(HandlePose(np.zeros(3), R_0.as_matrix()))
        turn = 0.0
        for _ in range(40):
            turn += rng.uniform(-0.4, 0.4)
            direction = rng.uniform(0.0, math.tau)
            swing = rng.uniform(0.0, 2.5)
            axis = [swing * math.cos(direction), swing * math.sin(direction), 0.0]
            R = R_0 * Rotation.from_rotvec(axis) * Rotation.from_euler("z", turn)
            handle.move(HandlePose(np.zeros(3), R.as_matrix()))
            assert handle.roll == pytest.approx(turn, abs=1e-9)


def test_a_handle_that_points_back_keeps_its_roll() -> None:
    handle = Handle(HandlePose(np.zeros(3), np.eye(3)))
    rolls = []
    for angle in np.arange(0.0, 2.0 * math.pi, 0.01):  # once head over heels
        R = Rotation.from_euler("x", angle).as_matrix()
        handle.move(HandlePose(np.zeros(3), R))
        rolls.append(handle.roll)
    assert np.abs(rolls).max() < 1e-9


# --- walls


def test_the_nearest_point_is_inside_and_near() -> None:
    rng = np.random.default_rng(11)
    inside = 0
    for _ in range(3000):
        p = rng.normal(0.0, 0.12, 3)
        q, wall = WORKSPACE.nearest(p)
        depth = np.linalg.norm(q)
        assert 0.030 <= depth <= 0.220
        assert q[2] >= depth * math.cos(1.0472)
        assert (wall == "") == np.array_equal(p, q)
        inside += wall == ""
        again, held = WORKSPACE.nearest(q)
        assert again == pytest.approx(q, abs=1e-12)
        assert held == "" or wall != ""
    print(f"{inside} of 3000 inside")
    assert 100 < inside < 2900


# --- the camera


def test_the_view_is_the_simulators_camera_wherever_the_endoscope_is() -> None:
    """MuJoCo's own kinematics is the oracle: 50 postures of the endoscope arm."""
    mujoco = pytest.importorskip("mujoco")
    from surg_sim.physics.endoscope_projection import EndoscopeView
    from surg_sim.physics.world import World

    cell = surg_core.load_cell(TWO_ARMS)
    held = held_camera(cell)
    world = World(cell)
    view = EndoscopeView(world.model, world.data)
    joints = [
        world.model.joint(f"ECM_{name}").qposadr[0] for name in cell.arms["ECM"].robot.joint_names
    ]
    rng = np.random.default_rng(5)
    for _ in range(50):
        q = np.array(cell.arms["ECM"].robot.home) + rng.uniform(-0.6, 0.6, 6)
        world.data.qpos[joints] = q
        mujoco.mj_kinematics(world.model, world.data)
        assert held.view(q) == pytest.approx(view.pose[:3, :3], abs=1e-6)


def test_a_measured_camera_replaces_the_drawing(tmp_path: Path) -> None:
    import shutil

    shutil.copytree(paths.ROOT / "cells", tmp_path / "cells")
    for part in ("robots", "instruments", "urdf"):
        shutil.copytree(
            paths.ROOT / "src/surg_description" / part, tmp_path / "src/surg_description" / part
        )
    folder = tmp_path / "cells/sim_two_arms"
    file = folder / "calibration/camera_ECM.yaml"
    drawn = held_camera(surg_core.load_cell(folder))
    file.write_text(yaml.safe_dump(CAMERA))
    measured = held_camera(surg_core.load_cell(folder))
    assert not np.allclose(measured.R_FV, drawn.R_FV)
    assert pytest.approx(Rotation.from_quat([0, 0, 0.6, 0.8]).as_matrix()) == measured.R_FV
    file.write_text(yaml.safe_dump({**CAMERA, "n": 2}))
    with pytest.raises(surg_core.ConfigError, match=r"camera_ECM.yaml: n: 2; allowed: number of"):
        held_camera(surg_core.load_cell(folder))


CAMERA = {
    "format": "surg_camera/1",
    "quaternion": [0.0, 0.0, 0.6, 0.8],
    "residual": 0.004,
    "n": 15,
    "date": "2026-11-21",
}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "surg_camera/2"}, "format: 'surg_camera/2'; allowed: surg_camera/1"),
        ({"quaternion": [0, 0, 0, 2]}, "quaternion: .* is not of unit length"),
        ({"quaternion": [0, 0, 1]}, "quaternion: .* is not of unit length"),
        ({"quaternion": "up"}, "quaternion: 'up' is not of unit length"),
        ({"quaternion": [math.nan, 0, 0, 1]}, "quaternion: .* is not of unit length"),
        ({"residual": 0.06}, "residual: 0.06; allowed: 0 to 0.05"),
        ({"residual": -1e-9}, "residual: -1e-09; allowed"),
        ({"residual": math.nan}, "residual: nan; allowed"),
        ({"residual": True}, "residual: True; allowed"),
        ({"n": 2}, "n: 2; allowed: number of views, 3 or more"),
        ({"n": 12.5}, "n: 12.5; allowed"),
        ({"n": math.nan}, "n: nan; allowed"),
        ({"n": True}, "n: True; allowed"),
        ({"date": "yesterday"}, "date: 'yesterday'; allowed: day of the measurement"),
        ({"date": 20261121.5}, "date: '20261121.5'; allowed"),
        ({"residuals": 0.0}, "residuals: unknown; allowed: format, quaternion, residual, n, date"),
        *(({key: None}, f"camera.yaml: {key}: is missing; allowed") for key in CAMERA),
    ],
)
def test_a_camera_without_evidence_is_refused(change: dict[str, object], words: str) -> None:
    values = {k: v for k, v in {**CAMERA, **change}.items() if v is not None}
    with pytest.raises(surg_core.ConfigError, match=words):
        camera_file.parse(values, "camera.yaml")


def test_a_measured_camera_says_how_good_it_is() -> None:
    found = camera_file.parse(CAMERA, "camera.yaml")
    assert (found.residual, found.n, found.date.isoformat()) == (0.004, 15, "2026-11-21")
    assert pytest.approx(Rotation.from_quat([0, 0, 0.6, 0.8]).as_matrix()) == found.R_FV


def test_a_moving_endoscope_is_applied_exactly_once() -> None:
    """The scope rolls and swings while the hand moves right: the tip moves right in each picture.

    Mapped not at all, or twice, the same run is wrong by more than a third of its way.
    """
    arm, hand = GateArm(), Hand()
    arm.R_WR = Rotation.from_rotvec([0.3, 0.8, -0.4]).as_matrix()
    teleop = Teleop(settings(), scale=1.0)
    teleop.enable()
    right = np.array([1e-4, 0.0, 0.0])
    errors: dict[int, float] = {0: 0.0, 1: 0.0, 2: 0.0}
    for k in range(400):
        now = arm.tick * TICK
        R_WV = Rotation.from_euler("zyx", [0.01 * k, 0.3 * math.sin(0.02 * k), 0.4]).as_matrix()
        if k > 5:
            hand.move(right)
        out = teleop.tick(now, hand.sample(now), arm.view(), CameraView(R_WV))
        before = arm.p
        arm.step(out.commands)
        if k <= 10:
            continue
        moved = arm.p - before
        R_RV = arm.R_WR.T @ R_WV
        for times in errors:
            expected = np.linalg.matrix_power(R_RV, times) @ right
            errors[times] = max(errors[times], float(np.linalg.norm(moved - expected)))
    assert errors[1] < 1e-12
    assert errors[0] > 0.3e-4
    assert errors[2] > 0.3e-4


# --- seat and pedals


def test_the_camera_pedal_hands_the_leader_over_and_back() -> None:
    hand, psm, ecm = Hand(), GateArm(), GateArm(p=np.array([0.0, 0.01, 0.06]))
    seat = ArmSwitch(
        Teleop(settings(), scale=1.0), Teleop(settings(arm="ECM", jaw=None), scale=1.0)
    )
    pedals = PedalMonitor()
    seat.enable()

    def run(n: int, step: float) -> dict[str, State]:
        for _ in range(n):
            now = psm.tick * TICK
            hand.move(np.array([step, 0.0, 0.0]))
            sample = pedals.merge(hand.sample(now), now)
            views = {"PSM1": psm.view(), "ECM": ecm.view()}
            outputs = seat.tick(now, sample, views, CameraView(np.eye(3)))
            psm.step(outputs["PSM1"].commands)
            ecm.step(outputs["ECM"].commands)
        return {arm: out.state for arm, out in outputs.items()}

    assert run(10, 1e-4) == {"PSM1": State.FOLLOWING, "ECM": State.CLUTCHED}
    pedals.press("/console", "camera", True, psm.tick * TICK)
    pedals.press("/footpedals", "camera", True, psm.tick * TICK)
    p_psm, p_ecm = psm.p, ecm.p
    assert run(100, 1e-4) == {"PSM1": State.CLUTCHED, "ECM": State.FOLLOWING}
    assert np.linalg.norm(psm.p - p_psm) < 1e-3
    assert (ecm.p - p_ecm)[0] == pytest.approx(0.01, abs=5e-4)
    pedals.press("/console", "camera", False, psm.tick * TICK)
    assert run(10, 0.0)["ECM"] is State.FOLLOWING  # the other foot is still down
    pedals.press("/footpedals", "camera", False, psm.tick * TICK)
    assert run(100, 0.0) == {"PSM1": State.FOLLOWING, "ECM": State.CLUTCHED}
    assert psm.refusals == ecm.refusals == []


def test_the_button_enable_ends_only_what_the_hand_is_on() -> None:
    """What says "press enable" can be obeyed with the device itself."""
    hand, arm, seat = Hand(), GateArm(), ArmSwitch(Teleop(settings()))

    def run(state: State, n: int = 100) -> bool:
        for _ in range(n):
            now = arm.tick * TICK
            out = seat.tick(now, hand.sample(now), {"PSM1": arm.view()}, CameraView(np.eye(3)))
            arm.step(out["PSM1"].commands)
        assert out["PSM1"].state is state, out["PSM1"].message
        return seat.enables(frozenset(hand.buttons | {"enable"}))

    assert run(State.DISABLED)
    seat.enable()
    assert not run(State.FOLLOWING)
    hand.buttons = {"clutch"}
    assert not run(State.CLUTCHED)
    hand.buttons = {"camera"}  # nobody holds the endoscope: it clutches
    assert not run(State.CLUTCHED)
    seat.enable()
    hand.buttons = set()
    assert not run(State.FOLLOWING)
    hand.move(np.array([0.5, 0.0, 0.0]))
    assert run(State.CLUTCHED)  # let go: "press and release the clutch, or press enable"
    for state, left in ((State.WAITING, ArmState.PAUSED), (State.FAULT, ArmState.FAULT)):
        arm.leave(left, "force")
        assert run(state)


class Floor:
    """A pedal node that repeats what is down 20 times a second, before a hand on an arm."""

    def __init__(self) -> None:
        self.hand, self.arm, self.pedals = Hand(), GateArm(), PedalMonitor()
        self.teleop = Teleop(settings(), scale=1.0)
        self.down, self.speaks, self.sent = False, True, 0

    def run(self, ticks: int) -> State:
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

    def ticks_to(self, state: State, at_most: int = 2000) -> int:
        return next(i + 1 for i in range(at_most) if self.run(1) is state)


def test_f03_pedals_that_are_killed_hold_the_arm_within_their_limit() -> None:
    floor = Floor()
    floor.teleop.enable()
    assert floor.run(500) is State.FOLLOWING
    floor.speaks = False  # kill -9 with the clutch up
    last = (floor.arm.tick - 1) // 25 * 25
    floor.ticks_to(State.WAITING)
    # The first tick later than the limit after the last word.
    assert floor.arm.tick - 1 - last == round(PRESENCE_TIMEOUT / TICK) + 1
    assert "the buttons of /pedals are silent" in floor.out.message
    rest, sent = floor.arm.p, floor.sent
    assert floor.run(1000) is State.WAITING
    assert floor.sent == sent and np.linalg.norm(floor.arm.p - rest) < 1e-3
    # They are back, with the clutch let go meanwhile: that is no act.
    floor.speaks = True
    assert floor.run(1000) is State.WAITING and floor.sent == sent
    assert "press and release the clutch, or press enable" in floor.out.message
    floor.down = True
    floor.ticks_to(State.CLUTCHED)
    floor.down = False
    floor.ticks_to(State.FOLLOWING)
    assert floor.arm.refusals == []


def test_f03_pedals_killed_with_the_clutch_down_engage_nothing_when_they_come_back_up() -> None:
    floor = Floor()
    floor.teleop.enable()
    floor.run(500)
    floor.down = True
    floor.ticks_to(State.CLUTCHED)
    floor.run(200)
    floor.speaks = False
    floor.ticks_to(State.WAITING)
    floor.down, floor.speaks = False, True
    assert floor.run(1000) is State.WAITING


def test_enable_goes_on_without_pedals_that_are_silent() -> None:
    floor = Floor()
    floor.down = True
    floor.run(500)
    floor.speaks = False
    floor.run(500)
    floor.pedals.forget(floor.arm.tick * TICK)
    floor.teleop.enable()
    assert floor.run(500) is State.FOLLOWING  # what they held down is up
    floor.speaks = True
    floor.ticks_to(State.CLUTCHED)  # their foot is on it again


def test_a_pedal_that_speaks_on_change_alone_is_not_watched() -> None:
    pedals, hand = PedalMonitor(), Hand()
    for k in range(4):  # a change, and the same again three times, as a driver may do
        pedals.press("/dvrk", "clutch", True, 0.1 * k)
    pedals.press("/dvrk", "clutch", False, 5.0)
    assert pedals.problem(60.0) == ""
    assert pedals.merge(hand.sample(60.0), 60.0).problem == ""


# --- what a network holds up


def test_f03_messages_that_a_stall_held_up_are_as_old_as_they_are() -> None:
    """Random networks with stalls; the true time of arrival without the stall is the oracle."""
    worst, stalled = 0.0, 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        offset = rng.uniform(-1e6, 1e6)  # between the clocks
        delay, period = rng.uniform(0.0, 0.2), rng.choice([0.002, 0.033])
        arrivals, free, sent = Arrivals(), 0.0, 0.0
        stall = (rng.uniform(1.0, 3.0), rng.uniform(0.1, 1.5))
        for _ in range(int(5.0 / period)):
            sent += period
            way = delay + rng.uniform(0.0, 0.01)
            held = stall[0] < sent + way < sum(stall)
            came = max(sum(stall) if held else sent + way, free)
            free = came
            found = arrivals.of(sent + offset, came)
            stalled += held
            assert found <= came
            worst = max(worst, abs(found - (sent + way)) if sent > 0.5 else 0.0)
    print(f"{stalled} messages held up; their age found within {1e3 * worst:.1f} ms")
    assert stalled > 10_000 and worst < 0.011  # the jitter of the way


def test_f09_no_clock_that_is_set_makes_a_message_late() -> None:
    for step in (-3600.0, -1.0, -0.2, 0.2, 1.0, 3600.0):
        arrivals = Arrivals()
        for k in range(2000):
            now = 0.01 * k
            stamp = 1e9 + now + (step if k >= 1000 else 0.0)
            assert arrivals.of(stamp, now) == pytest.approx(now, abs=1e-6)


def test_f09_a_stamp_that_stands_still_makes_no_message_late() -> None:
    arrivals = Arrivals()  # a link that is lost: its controller goes on with the last state
    assert {arrivals.of(7.0, 0.002 * k) - 0.002 * k for k in range(3000)} == {0.0}


def test_a_way_that_stays_longer_is_taken_as_it_is() -> None:
    arrivals = Arrivals()
    ages = []
    for k in range(1000):
        sent = 0.01 * k
        came = sent + (0.3 if k >= 300 else 0.0)
        ages.append(came - arrivals.of(sent, came))
    assert max(ages[:300]) == 0.0
    assert min(ages[300:450]) == pytest.approx(0.3)
    assert max(ages[300 + int(2 * Arrivals.WINDOW / 0.01) + 1 :]) < 1e-9


def test_f03_a_leader_whose_messages_are_held_up_is_not_followed() -> None:
    """A stall of 0.3 s between leader and teleoperation: hold, and the burst engages nothing."""
    leader, arrivals, arm = CrtkLeader("far"), Arrivals(), GateArm()
    teleop = Teleop(settings(), scale=1.0)
    teleop.enable()
    sent: list[tuple[float, np.ndarray]] = []
    p, states, messages = np.zeros(3), [], []
    for k in range(1500):
        now = arm.tick * TICK
        stalls = 500 <= k < 650
        if k % 5 == 0:
            p = p + np.array([2e-4, 0.0, 0.0])
            sent.append((now, p))
        while sent and not stalls:
            stamp, place = sent.pop(0)
            at = arrivals.of(stamp + 1e6, now)
            if now - at > 0.1:
                leader.on_late(now, now - at)
            leader.on_pose(at, place, np.array([0.0, 0.0, 0.0, 1.0]))
        out = teleop.tick(now, leader.read(now), arm.view(), CameraView(np.eye(3)))
        states.append(out.state)
        messages.append(out.message)
        arm.step(out.commands)
    assert states[499] is State.FOLLOWING
    waits = states.index(State.WAITING, 500)
    assert waits - 500 <= 51
    assert set(states[waits:]) == {State.WAITING}  # an act is needed
    assert arm.refusals == []


# --- the picture


def test_f08_a_picture_that_stalls_or_freezes_is_said_within_three_periods() -> None:
    watch = PictureWatch("endoscope_left")
    assert watch.problem(0.0) == ""
    now = 0.0
    for k in range(100):
        now = 0.05 * k
        watch.picture(now, 1 + k, k)
        assert watch.problem(now + 0.049) == ""
    assert watch.problem(now + 0.149) == ""
    assert "endoscope_left sends no pictures" in watch.problem(now + 0.151)
    for k in range(100, 104):  # the same pixels with new stamps
        now = 0.05 * k
        watch.picture(now, 1 + k, 99)
    assert "endoscope_left repeats the same picture" in watch.problem(now)
    watch.picture(now + 0.05, 105, 105)
    assert watch.problem(now + 0.05) == ""
    for k in range(4):  # new pixels with an old stamp
        watch.picture(now + 0.1 + 0.05 * k, 105, 200 + k)
    assert watch.problem(now + 0.3) != ""


# --- the assistant's instrument


def test_a_virtual_arm_is_the_simulators_assistant() -> None:
    """The simulator's own kinematics is the oracle for pose and joints."""
    assistant = pytest.importorskip("surg_sim.physics.assistant_arm")
    arm = ServoInstrument("/teleop", np.eye(3))
    assert arm.view() is None
    rng = np.random.default_rng(2)
    for _ in range(100):
        joints = rng.uniform([-0.8, -0.8, 0.05, -3.0], [0.8, 0.8, 0.2, 3.0])
        arm = ServoInstrument("/teleop", np.eye(3))
        arm.joints(1.0, 0, joints)
        view = arm.view()
        assert view.p_set == pytest.approx(assistant.forward(joints)[:3, 3])
        assert (view.state, view.stream) == (ArmState.ENABLED, "/teleop")
        pose = TipPose(view.p_set, joints[3] + 0.1)
        asked = arm.convert(ArmCommands(servo_cp=pose, jaw=0.3, state="pause", claim=True))
        assert asked.servo_jp == pytest.approx(
            [*TipPose(view.p_set, 0.0).joints[:3], joints[3] + 0.1]
        )
        R = Rotation.from_quat(pose.q).as_matrix()
        assert assistant.forward(asked.servo_jp)[:3, :3] == pytest.approx(R)
        assert (asked.jaw, asked.state, asked.claim, asked.servo_cp) == (0.3, None, False, None)
        assert arm.convert(ArmCommands(hold=True)).servo_jp == pytest.approx(joints)
    arm.joints(2.0, 0, np.full(4, np.nan))
    assert arm.view().received == 1.0


def test_a_virtual_arm_that_was_silent_is_where_it_is() -> None:
    """Its set-point is the target again only from the next command on."""
    home, there = np.array([0.0, 0.0, 0.09, 0.0]), np.array([0.05, 0.0, 0.1, 0.0])
    arm = ServoInstrument("/teleop", np.eye(3))
    arm.joints(1.0, 0, home)
    arm.jaw(0.2)
    arm.convert(ArmCommands(servo_cp=TipPose(np.array([0.0, 0.0, 0.1]), 0.0), jaw=0.5))
    for now, silent in ((1.0999, False), (1.1998, False), (1.3, True)):
        arm.joints(now, 0, there)
        view = arm.view()
        assert view.p_set == pytest.approx(virtual_tip(*there[:3]) if silent else [0.0, 0.0, 0.1])
        assert np.isnan(view.jaw_set) if silent else view.jaw_set == 0.5
    arm.jaw(0.3)
    assert arm.view().jaw_set == 0.3


# --- parameters


def test_a_system_is_read_from_parameters() -> None:
    params = {
        "cell": TWO_ARMS,
        "leader": "crtk",
        "settings": {"name": "MTMR"},
        "scale": 0.4,
        "second_leader": "motion",
        "second_settings": {"file": str(BUNDLED), "name": "helper"},
        "second_arm": "assistant",
        "assistant_frame": [0.0, 0.0, 0.0, 1.0],
    }
    found = read_setup(params, "/teleop")
    first, second = found.hands
    assert set(first.switch.arms) == {"PSM1", "ECM"}
    assert first.switch.endoscope.lock_rotation
    assert first.switch.instrument.scale == 0.4
    assert first.switch.instrument.settings.quiet > 0.1
    assert set(second.switch.arms) == {"assistant"}
    assert found.heard == ["PSM1", "ECM"]


@pytest.mark.parametrize(
    ("params", "name", "allowed"),
    [
        ({}, "leader", "text"),
        ({"leader": "crtk", "arm": "ECM"}, "arm", "PSM1, assistant"),
        ({"leader": "crtk", "scale": 5.0}, "scale", "0.01 to 1"),
        ({"leader": "crtk", "scale": "nan"}, "scale", "0.01 to 1"),
        ({"leader": "crtk", "speed": 1}, "speed", "~second_leader"),
        ({"leader": "crtk", "mapping": "both"}, "mapping", "position, rate"),
        ({"leader": "crtk", "settings": 3}, "settings", "dictionary"),
        ({"leader": "crtk", "lockstep": True}, "lockstep", "false"),
        ({"leader": "crtk", "enabled": True}, "enabled", "~lockstep"),
        ({"leader": "crtk", "arm": "assistant"}, "assistant_frame", "4 numbers"),
        ({"leader": "crtk", "cell": paths.ROOT / "cells/sim_ur5e"}, "view", "x, y, z, w"),
        (
            {"leader": "crtk", "second_leader": "crtk", "second_arm": "PSM1"},
            "second_arm",
            "does not drive",
        ),
    ],
)
def test_a_parameter_that_must_not_be_used_is_named(params: dict, name: str, allowed: str) -> None:
    with pytest.raises(ParamError) as caught:
        read_setup({"cell": TWO_ARMS, **params}, "/teleop")
    assert caught.value.name == name
    assert allowed in caught.value.allowed
