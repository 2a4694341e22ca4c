"""The Lambda.7 node against a stand-in for its library: pose, gripper, buttons in, forces out.

The axes of the device: x towards the operator, y to the right, z up. The view's: right, down, away.
"""

import math
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.graph import contract
from helpers.graph.ros import RosGraph
from helpers.teleop import lambda7
from helpers.teleop.lambda7 import State
from surg_cli.graph.processes import Child
from surg_core import axis_angle_to_matrix, quaternion_xyzw_to_matrix

pytestmark = pytest.mark.ros

R_VM = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The stand-in, compiled."""
    return lambda7.build(tmp_path_factory.mktemp("sdk"))


@dataclass
class Bench:
    """A node on a stand-in device, and what it says."""

    graph: RosGraph
    library: Path
    state: State
    heard: dict[str, list[Any]] = field(default_factory=dict)
    subscribers: list[Any] = field(default_factory=list)

    def start(self, env: dict[str, str] | None = None, **params: object) -> Child:
        """Starts the node and hears it."""
        import rospy
        from geometry_msgs.msg import PoseStamped
        from sensor_msgs.msg import JointState, Joy
        from std_msgs.msg import String

        from crtk_msgs.msg import OperatingState

        for topic, kind in (
            ("/MTMR/measured_cp", PoseStamped),
            ("/MTMR/gripper/measured_js", JointState),
            ("/MTMR/buttons", Joy),
            ("/MTMR/operating_state", OperatingState),
            ("/MTMR/error", String),
            ("/footpedals/clutch", Joy),
        ):
            self.heard[topic] = []
            self.subscribers.append(
                rospy.Subscriber(topic, kind, self.heard[topic].append, queue_size=None)
            )
        where = {"FORCEDIM_LIBRARY": str(self.library)} if env is None else env
        where["LAMBDA7_STUB"] = str(self.graph.folder / "state")
        return self.graph.node(
            "surg_lambda7", "lambda7_node", "/lambda7", {"name": "MTMR", **params}, env=where
        )

    def until(self, condition: Any, what: str) -> None:
        """Waits for something, at most a minute: a machine may be busy."""
        self.graph.wait_for(condition, 60.0, what)

    def latest(self, topic: str) -> Any:
        """What was said last on a topic of the leader."""
        return self.heard[f"/MTMR/{topic}"][-1]

    def following(self) -> None:
        """Waits until poses flow."""
        self.until(lambda: len(self.heard["/MTMR/measured_cp"]) > 3, "poses")

    def settled(self) -> tuple[np.ndarray, np.ndarray]:
        """Position and orientation in V, of a reading taken after now."""
        read = self.state.poses
        self.until(lambda: self.state.poses > read + 4, "a cycle")
        n = len(self.heard["/MTMR/measured_cp"])
        self.until(lambda: len(self.heard["/MTMR/measured_cp"]) > n + 1, "a pose")
        pose = self.latest("measured_cp").pose
        p, q = pose.position, pose.orientation
        return np.array([p.x, p.y, p.z]), quaternion_xyzw_to_matrix([q.x, q.y, q.z, q.w])


@pytest.fixture
def bench(ros_graph: RosGraph, rospy_node: str, library: Path) -> Iterator[Bench]:
    """A bench with a good device."""
    bench = Bench(ros_graph, library, lambda7.share(ros_graph.folder / "state"))
    yield bench
    for subscriber in bench.subscribers:
        subscriber.unregister()


def test_hand_and_picture_agree_and_the_handle_stays_free(bench: Bench) -> None:
    child = bench.start(clutch_button=0)
    bench.following()
    assert contract.found(bench.graph, "/lambda7") == contract.promised("lambda7", "MTMR")
    state = bench.state
    for moved, goes in (
        ([0.0, 0.01, 0.0], [0.01, 0.0, 0.0]),  # right: right
        ([0.0, 0.0, 0.01], [0.0, -0.01, 0.0]),  # up: up
        ([-0.01, 0.0, 0.0], [0.0, 0.0, 0.01]),  # away: away
    ):
        state.p[:] = moved
        assert bench.settled()[0] == pytest.approx(goes, abs=1e-12)
    # The handle's axis points away from the operator: clockwise about it is a clockwise roll.
    for angle in (0.0, 0.7, -2.0):
        R_MH = axis_angle_to_matrix([-1.0, 0.0, 0.0], angle)
        state.R[:] = R_MH.ravel().tolist()
        R_VH = bench.settled()[1]
        assert pytest.approx(axis_angle_to_matrix([0.0, 0.0, 1.0], angle), abs=1e-9) == R_VH
    rng = np.random.default_rng(7)
    for _ in range(5):
        R_MH = axis_angle_to_matrix(rng.normal(size=3), rng.uniform(0.0, math.pi))
        state.R[:] = R_MH.ravel().tolist()
        assert pytest.approx(R_VM @ R_MH @ R_VM.T, abs=1e-9) == bench.settled()[1]

    state.gripper = 0.3
    bench.settled()
    assert bench.latest("gripper/measured_js").position == (0.3,)
    state.buttons = 0b101
    bench.until(lambda: bench.latest("buttons").buttons[:3] == (1, 0, 1), "buttons")
    bench.until(lambda: bench.heard["/footpedals/clutch"][-1].buttons == (1,), "clutch")
    assert bench.latest("operating_state").state == "ENABLED"
    assert bench.latest("operating_state").is_homed
    assert state.max_force == 5.0
    assert state.forces >= state.poses - 1 > 0
    assert state.nonzero_forces == 0

    child.process.send_signal(signal.SIGTERM)
    bench.until(lambda: child.exit_code is not None, "the end")
    assert child.exit_code == 0
    # Open, capabilities, forces; at the end forces off, stop, close. No initialisation was needed.
    assert lambda7.calls(state) == "owglGmFfsc"
    assert bench.latest("operating_state").state == "DISABLED"


def test_an_old_pose_is_never_repeated(bench: Bench) -> None:
    bench.start()
    bench.following()
    bench.state.old = 1
    time.sleep(0.1)
    said, read, forces = (
        len(bench.heard["/MTMR/measured_cp"]),
        bench.state.poses,
        bench.state.forces,
    )
    bench.until(lambda: bench.state.poses > read + 100, "a hundred cycles")
    assert len(bench.heard["/MTMR/measured_cp"]) == said
    assert bench.state.forces >= forces + 99  # the handle stays free all the same
    bench.state.old = 0
    bench.until(lambda: len(bench.heard["/MTMR/measured_cp"]) > said, "poses again")


def test_a_left_hand_and_an_auto_init(bench: Bench) -> None:
    bench.state.left_handed, bench.state.initialised, bench.state.gripper = 1, 0, -0.2
    child = bench.start(device=0, max_force=8.0, master_to_view=R_VM.ravel().tolist())
    bench.following()
    assert bench.latest("gripper/measured_js").position == (0.2,)
    assert lambda7.calls(bench.state) == "OwgliSGmF"
    assert bench.state.max_force == 8.0
    assert "HANDS OFF" in child.log_tail(10)


def test_a_force_at_the_tip_reaches_the_hand_and_fades_with_silence(bench: Bench) -> None:
    """In the device's axes, at most ~max_force; 50 cycles of 1 ms after the last word it is zero.

    A cycle is never shorter than 1 ms, so that cycles count time from below on any machine.
    """
    import rospy
    from geometry_msgs.msg import WrenchStamped

    bench.start(haptics=True, max_force=4.0, haptic_scale=2.0)
    bench.following()
    force = rospy.Publisher("/MTMR/servo_cf", WrenchStamped, queue_size=1, tcp_nodelay=True)
    bench.until(lambda: force.get_num_connections() > 0, "the force's connection")
    state = bench.state

    def say(f_V: list[float], allowed: bool = True) -> None:
        message = WrenchStamped()
        if allowed:
            message.header.stamp = rospy.Time.now()
        w = message.wrench.force
        w.x, w.y, w.z = f_V
        force.publish(message)

    def felt() -> np.ndarray:
        return np.array(state.force[:3])

    def push(f_V: list[float], seconds: float = 1.2) -> np.ndarray:
        end, largest = time.monotonic() + seconds, np.zeros(3)
        while time.monotonic() < end:
            say(f_V)
            time.sleep(0.002)
            largest = max(largest, felt(), key=lambda f: float(np.linalg.norm(f)))
        return largest

    # 1 N away in the view, doubled: away from the operator is -x of the device.
    assert push([0.0, 0.0, 1.0]) == pytest.approx([-2.0, 0.0, 0.0], abs=1e-6)
    assert push([0.0, -9.0, 0.0]) == pytest.approx([0.0, 0.0, 4.0], abs=1e-6)  # up, at most 4 N
    for end in ("silence", "clutch"):
        push([1.5, 0.0, 0.0])
        bench.until(lambda: felt()[1] > 1.0 or bool(push([1.5, 0.0, 0.0], 0.1).any()), "a force")
        if end == "clutch":
            say([1.5, 0.0, 0.0], allowed=False)
        begin = state.forces
        while felt().any() and state.forces < begin + 200:
            time.sleep(1e-4)
        cycles = state.forces - begin
        print(f"{end}: zero after {cycles} cycles")
        assert not felt().any() and cycles <= 55
        assert state.max_force == 4.0
    quiet = state.nonzero_forces
    push([np.nan, 0.0, 0.0], 0.3)
    assert state.nonzero_forces == quiet


@pytest.mark.parametrize("fault", ["fail_pose", "fail_gripper", "fail_force", "nan", "mirror"])
def test_a_device_that_is_lost_is_silence(fault: str, bench: Bench) -> None:
    child = bench.start(clutch_button=0)
    bench.following()
    state = bench.state
    state.error = b"communication error (device unplugged)"
    if fault == "nan":
        state.p[1] = math.nan
    elif fault == "mirror":
        state.R[0] = -1.0
    else:
        setattr(state, fault, 1)
    bench.until(lambda: child.exit_code is not None, "the end")
    assert child.exit_code == 1
    said = bench.latest("error").data
    assert said in child.log_tail(5)
    assert said.startswith("Lambda.7: ")
    assert "start" in said
    if fault.startswith("fail"):
        assert "communication error (device unplugged)" in said
    assert bench.latest("operating_state").state == "FAULT"
    assert bench.heard["/footpedals/clutch"][-1].buttons == (1,)  # a pedal that is gone is pressed
    assert all(np.isfinite(m.pose.position.y) for m in bench.heard["/MTMR/measured_cp"])
    assert lambda7.calls(state).endswith("sc")


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        ("present", "no device: no device found; plug it in and switch it on"),
        ("wrist", "has no wrist"),
        ("init_works", "did not find its reference: no device found; hands off"),
    ],
)
def test_a_device_that_does_not_serve_says_why(broken: str, said: str, bench: Bench) -> None:
    bench.state.error = b"no device found"
    setattr(bench.state, broken, 0)
    bench.state.initialised = 0
    child = bench.start()
    bench.until(lambda: child.exit_code is not None, "the end")
    assert child.exit_code == 1
    assert said in child.log_tail(5)
    assert bench.heard["/MTMR/measured_cp"] == []
    assert "F" not in lambda7.calls(bench.state)  # forces were never on


def test_a_device_that_moves_by_itself_may_be_forbidden(bench: Bench) -> None:
    bench.state.initialised = 0
    child = bench.start(auto_init=False)
    bench.until(lambda: child.exit_code is not None, "the end")
    assert "has not found its reference" in child.log_tail(5)
    assert "i" not in lambda7.calls(bench.state)


@pytest.mark.untimed
def test_a_missing_library_names_every_place_and_the_cure(bench: Bench, tmp_path: Path) -> None:
    other = tmp_path / "sdk/lib/release/lin-x86_64-gcc"
    other.mkdir(parents=True)
    (other / "libdrd.so.3.17.0").write_bytes(b"no library")
    env = {"FORCEDIM_LIBRARY": "/nowhere/a.so", "FDSDK": str(tmp_path / "sdk"), "HOME": "/hearth"}
    child = bench.start(env=env)
    bench.until(lambda: child.exit_code is not None, "the end")
    assert child.exit_code == 1
    text = child.log_tail(30)
    places = ["/nowhere/a.so", f"{other}/libdrd.so.3:", f"{other}/libdrd.so.3.17.0"]
    places += ["/hearth/.local/lib/libdrd.so.3", "/usr/local/lib/libdrd.so.3", "  libdrd.so.3:"]
    at = [text.index(place) for place in places]
    assert at == sorted(at), "not in the order of the search"
    assert "set FDSDK" in text


@pytest.mark.untimed
def test_it_is_found_in_the_sdks_folder_by_its_version(bench: Bench, tmp_path: Path) -> None:
    folder = tmp_path / "sdk/lib/release/lin-x86_64-gcc"
    folder.mkdir(parents=True)
    (folder / "libdrd.so.3.17.0").symlink_to(bench.library)
    child = bench.start(env={"FDSDK": str(tmp_path / "sdk")})
    bench.following()
    assert f"Lambda.7, by {folder}/libdrd.so.3.17.0" in child.log_tail(5)


@pytest.mark.untimed
def test_a_library_without_a_function_is_named(bench: Bench, tmp_path: Path) -> None:
    library = lambda7.build(tmp_path, "-DdhdIsLeftHanded=somethingElse")
    child = bench.start(env={"FORCEDIM_LIBRARY": str(library), "HOME": "/hearth"})
    bench.until(lambda: child.exit_code is not None, "the end")
    assert f"{library}: has no function dhdIsLeftHanded" in child.log_tail(30)


@pytest.mark.untimed
@pytest.mark.parametrize(
    ("params", "said"),
    [
        ({"master_to_view": [1.0, 0.0, 0.0]}, "~master_to_view: 3 numbers; allowed: 9"),
        ({"master_to_view": [0.0] * 9}, "~master_to_view: no rotation"),
        (
            {"master_to_view": [-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]},
            "~master_to_view: a mirror",
        ),
        ({"haptics": True, "max_force": 0.0}, "~max_force: 0; allowed: 0.01 to 20"),
        ({"haptic_scale": 0.0}, "~haptic_scale: 0; allowed: 0.01 to 10"),
        ({"max_force": 50.0}, "~max_force: 50; allowed: 0 to 20"),
        ({"publish_rate": "fast"}, "~publish_rate: wrong type"),
        ({"name": "/x"}, "~name: '/x'"),
        ({"clutch_button": 9}, "~clutch_button: 9; allowed: -1 to 7"),
    ],
)
def test_a_wrong_parameter_is_refused(params: dict[str, object], said: str, bench: Bench) -> None:
    child = bench.start(**params)
    bench.until(lambda: child.exit_code is not None, "the end")
    assert child.exit_code == 2
    assert said in child.log_tail(5)
    assert lambda7.calls(bench.state) == ""
