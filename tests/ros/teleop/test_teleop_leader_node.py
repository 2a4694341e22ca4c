"""Leaders as processes of their own: on topics, and from outside the tree."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.graph import contract
from helpers.graph.ros import RosGraph
from helpers.teleop.input_devices import GAMEPAD, PEDALS, Machine
from surg_cli.host import paths
from surg_teleop.leaders.bundled.gamepad import Gamepad
from surg_teleop.leaders.bundled.pedals import Pedals
from surg_teleop.leaders.leader import LeaderError

pytestmark = pytest.mark.ros


@dataclass
class Ears:
    """Hears topics; keeps everything."""

    graph: RosGraph
    heard: dict[str, list[Any]] = field(default_factory=dict)

    def listen(self, topic: str, kind: type) -> list[Any]:
        """What is said on a topic from now on."""
        import rospy

        rospy.Subscriber(topic, kind, self.heard.setdefault(topic, []).append, queue_size=None)
        return self.heard[topic]

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Waits at most a minute: a machine may be busy."""
        self.graph.wait_for(condition, 60.0, what)


@pytest.fixture
def ears(ros_graph: RosGraph, rospy_node: str) -> Ears:
    """Ears on the test's graph."""
    return Ears(ros_graph)


def test_a_gamepad_on_topics_is_silent_when_it_has_gone(ears: Ears, rospy_node: str) -> None:
    """Before that: its topics are those of docs/reference/topics.yaml."""
    from geometry_msgs.msg import TwistStamped
    from sensor_msgs.msg import JointState, Joy
    from std_msgs.msg import String

    from crtk_msgs.msg import OperatingState
    from surg_teleop.leaders.leader_node import LeaderNode

    machine = Machine()
    pad = machine.plug(GAMEPAD)
    leader = Gamepad(host=machine)
    leader.open()
    node = LeaderNode(leader, pedals=True)
    rates = ears.listen("/gamepad/measured_cv", TwistStamped)
    joys = ears.listen("/gamepad/joy", Joy)
    grips = ears.listen("/gamepad/gripper/measured_js", JointState)
    states = ears.listen("/gamepad/operating_state", OperatingState)
    errors = ears.listen("/gamepad/error", String)
    clutch = ears.listen("/footpedals/clutch", Joy)
    now = 100.0

    def run(ticks: int) -> None:
        nonlocal now
        for _ in range(ticks):
            node.tick(now)
            now += 0.01

    def all_heard() -> bool:
        run(1)
        return bool(rates and joys and states and clutch)

    def settled() -> None:
        """No more messages are under way."""
        heard = -1
        while heard != len(joys):
            heard = len(joys)
            time.sleep(0.3)

    ears.until(all_heard, "connections")
    settled()
    published: list[Joy] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(node._joy, "publish", published.append)
        run(100)  # one second at rest: Joy at its autorepeat
    assert 20 <= len(published) <= 21

    pad.press("BTN_TR", "BTN_TL")
    pad.push("ABS_X", 1.0)
    pad.push("ABS_Z", 1.0)
    run(50)
    ears.until(lambda: bool(rates) and rates[-1].twist.linear.x > 0.0399, "a rate")
    ears.until(lambda: bool(grips) and 0.3 < grips[-1].position[0] < 0.6, "the jaw")
    ears.until(lambda: clutch[-1].buttons == (1,), "the clutch")
    assert joys[-1].axes[0] == pytest.approx(-1.0, abs=1e-3)
    assert states[-1].state == "ENABLED"

    machine.unplug(pad)
    run(1)
    ears.until(lambda: states[-1].state == "FAULT", "its state")
    ears.until(lambda: bool(errors), "its error")
    assert "has gone (No such device)" in errors[-1].data
    settled()
    said = len(rates), len(joys), len(grips)
    own = contract.found(ears.graph, rospy_node)
    assert {topic for topic in own if topic[2] == "out"} == contract.promised("leader", "gamepad")
    run(200)
    ears.until(lambda: len(states) > 10, "its state again and again")
    assert (len(rates), len(joys), len(grips)) == said
    back = machine.plug(GAMEPAD)
    back.press("BTN_TR")
    back.push("ABS_X", 1.0)
    run(200)
    ears.until(lambda: states[-1].state == "ENABLED", "it is back")
    ears.until(lambda: len(rates) > said[0], "rates again")
    settled()
    assert all(rate.twist.linear.x == 0.0 for rate in rates[said[0] :])
    leader.close()


def test_pedals_on_topics_fail_to_pressed(ears: Ears) -> None:
    from sensor_msgs.msg import Joy

    from surg_teleop.leaders.leader_node import LeaderNode

    machine = Machine()
    feet = machine.plug(PEDALS)
    leader = Pedals(host=machine)
    leader.open()
    node = LeaderNode(leader, pedals=True)
    clutch = ears.listen("/footpedals/clutch", Joy)
    present = ears.listen("/footpedals/operator_present", Joy)
    now = 0.0

    def pedals_are(clutch_is: int, present_is: int) -> bool:
        nonlocal now
        now += 0.01
        node.tick(now)
        return bool(clutch and present) and (
            clutch[-1].buttons == (clutch_is,) and present[-1].buttons == (present_is,)
        )

    ears.until(lambda: pedals_are(0, 0), "both released")
    feet.press("KEY_C")
    ears.until(lambda: pedals_are(0, 1), "the operator is there")
    machine.unplug(feet)
    ears.until(lambda: pedals_are(1, 0), "clutch pressed, nobody there")
    leader.close()


# -- refusals, and a leader from outside


@pytest.mark.parametrize(
    ("params", "said"),
    [
        ({"leader": "gamepad", "colour": "red"}, "~leader, ~settings, ~rate, ~pedals"),
        ({"rate": 5}, "from 20 to 500"),
        ({"pedals": "left"}, "~pedals is 'left'; allowed: true or false"),
        ({"settings": "fast"}, "~settings is 'fast'; allowed: a dictionary"),
        ({"settings": {"size": 3}}, "setting size is unknown; allowed: name, layout, device"),
    ],
)
def test_a_wrong_parameter_is_refused(params: dict[str, object], said: str) -> None:
    from surg_ros.params import ParamError, read
    from surg_teleop.leaders.leader import load
    from surg_teleop.leaders.leader_node import Parameters

    with pytest.raises((ParamError, LeaderError)) as caught:
        given = read(Parameters, params)
        load(given.leader, given.settings)
    assert said in str(caught.value)


def test_spherical_rates_have_a_topic(ears: Ears) -> None:
    """What `gamepad_spherical` says is read back by a CRTK leader as it was."""
    from sensor_msgs.msg import JointState

    from surg_teleop.leaders.bundled.crtk import CrtkLeader
    from surg_teleop.leaders.crtk_leader_node import CrtkTopics
    from surg_teleop.leaders.leader_node import LeaderNode

    machine = Machine()
    pad = machine.plug(GAMEPAD)
    leader = Gamepad(host=machine, layout="gamepad_spherical")
    leader.open()
    node, far = LeaderNode(leader, pedals=False), CrtkLeader("gamepad")
    CrtkTopics(far, threading.Lock(), threading.Event())
    rates = ears.listen("/gamepad/spherical/measured_js", JointState)
    now = 0.0

    def said() -> bool:
        nonlocal now
        now += 0.01
        node.tick(now)
        sample = far.read(time.monotonic())
        return bool(rates) and sample is not None and sample.rate.spherical.any()

    ears.until(lambda: not said() and bool(rates), "the rates at rest")
    pad.press("BTN_TR")
    pad.push("ABS_X", 1.0)
    ears.until(said, "the rates")
    told, heard = leader.read(now).rate, far.read(time.monotonic()).rate
    assert heard.spherical == pytest.approx(told.spherical) and np.abs(told.spherical).max() > 0.1
    assert heard.roll == told.roll and not heard.v_V.any()
    assert rates[-1].name == ["yaw", "pitch", "insertion", "roll"]
    # Joints of another arm, and CRTK's "not valid" (stamp 0), change nothing.
    import rospy

    stranger = rospy.Publisher("/gamepad/spherical/measured_js", JointState, queue_size=1)
    ears.until(lambda: stranger.get_num_connections() > 0, "the stranger's connection")
    elbow = JointState(name=["elbow"], velocity=[1.0])
    elbow.header.stamp = rospy.Time.now()
    invalid = JointState(name=["yaw", "pitch", "insertion", "roll"], velocity=[9.0] * 4)
    for message in (elbow, invalid):
        stranger.publish(message)
        ears.until(lambda sent=message: rates[-1].name == sent.name, "the stranger")
        assert far.read(time.monotonic()).rate.spherical == pytest.approx(told.spherical)
    stranger.unregister()
    leader.close()


OUTSIDE = (
    (paths.ROOT / "docs/guide/leaders.md")
    .read_text("utf-8")
    .split("```python\n")[1]
    .split("```")[0]
)
"""The leader that lies in no package of ours: the page's own."""


def test_a_leader_from_outside_the_tree_by_its_path(ears: Ears, tmp_path: Path) -> None:
    from geometry_msgs.msg import PoseStamped

    path = tmp_path / "circle.py"
    path.write_text(OUTSIDE)
    poses = ears.listen("/mine/measured_cp", PoseStamped)
    settings = {"name": "mine", "radius": 0.02}
    ears.graph.node("surg_teleop", "leader_node", "/leader", {"leader": path, "settings": settings})
    ears.until(lambda: len(poses) > 3, "poses")
    p = poses[-1].pose.position
    assert p.x**2 + p.y**2 == pytest.approx(0.02**2)
