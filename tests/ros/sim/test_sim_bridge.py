"""The bridge node in lock-step and free-run, answered by a controller of a few lines."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from helpers.graph import socket_jitter
from helpers.graph.ros import RosGraph
from surg_cli.graph import graph_probe, master, processes
from surg_cli.host import paths

pytestmark = pytest.mark.ros

CELL = paths.ROOT / "cells" / "sim_ur5e"
TICK_NS = 2_000_000


class Controller:
    """Answers every state with constant joint velocities, and speaks for participant `op`.

    Args:
        velocity: Of the first joint [rad/s].
        last: The tick for which the participant says `done`.
        jaw: Leave False to forget the tool link.
    """

    def __init__(self, velocity: float, last: int, jaw: bool = True) -> None:
        import rospy
        from sensor_msgs.msg import JointState

        from surg_msgs.msg import GroundTruth, LinkStatus, Ready, SimStatus

        self.velocity, self.last, self.jaw, self.silent = velocity, last, jaw, False
        self.stamps: list[int] = []
        self.truths: list[int] = []
        self.links: list[LinkStatus] = []
        self.repeats = 0
        self.status = SimStatus()
        keys = {"queue_size": 0, "tcp_nodelay": True}
        self.robot = rospy.Publisher("/PSM1/robot/servo_jv", JointState, **keys)
        self.tool = rospy.Publisher("/PSM1/tool/servo_jp", JointState, **keys)
        self.ready = rospy.Publisher("/sim/ready", Ready, **keys)
        self.topics = [
            self.robot,
            self.tool,
            self.ready,
            rospy.Subscriber(
                "/PSM1/robot/measured_js", JointState, self.on_state, tcp_nodelay=True
            ),
            rospy.Subscriber("/PSM1/tool/measured_js", JointState, lambda _: None),
            rospy.Subscriber("/PSM1/robot/status", LinkStatus, self.links.append),
            rospy.Subscriber("/sim/status", SimStatus, self.on_status),
        ]
        self.watchers = [rospy.Subscriber("/sim/ground_truth/state", GroundTruth, self.on_truth)]
        """Subscribers that must be connected before the first tick is answered."""

    def on_truth(self, message: object) -> None:
        self.truths.append(message.tick)

    @property
    def done(self) -> bool:
        return bool(self.status.state == self.status.STATE_DONE)

    def on_status(self, message: object) -> None:
        self.status = message

    def on_state(self, state: object) -> None:
        from sensor_msgs.msg import JointState

        from surg_msgs.msg import Ready

        stamp_ns = state.header.stamp.to_nsec()
        if self.stamps and stamp_ns <= self.stamps[-1]:
            self.repeats += 1
        else:
            self.stamps.append(stamp_ns)
        if self.silent:
            return
        if len(self.stamps) == 1:  # the bridge does not wait for those who only listen
            processes.wait_until(lambda: all(w.get_num_connections() for w in self.watchers), 8.0)
        tick = stamp_ns // TICK_NS
        self.ready.publish(Ready(tick=tick, participant="op", done=tick >= self.last))
        answer = JointState(velocity=[self.velocity] + [0.0] * 5)
        answer.header.stamp = state.header.stamp
        self.robot.publish(answer)
        if self.jaw:
            jaw = JointState(name=["jaw"], position=[0.3])
            jaw.header.stamp = state.header.stamp
            self.tool.publish(jaw)

    def close(self) -> None:
        self.silent = True
        for topic in [*self.topics, *self.watchers]:
            topic.unregister()


@contextmanager
def running(
    graph: RosGraph, controller: Controller, env: dict[str, str] | None = None, **params: object
) -> Iterator[object]:
    settings = {"cell": str(CELL), "participants": ["op"], **params}
    child = graph.node("surg_sim", "bridge_node.py", "/sim", settings, env=env)
    try:
        yield child
    finally:
        graph.supervisor.stop([child])
        controller.close()


def lockstep(
    graph: RosGraph, velocity: float, last: int, jitter_ms: float = 0.0, **params: object
) -> object:
    controller = Controller(velocity, last)
    env = socket_jitter.environment(jitter_ms) if jitter_ms else None
    with running(graph, controller, env, **params):
        graph.wait_for(lambda: controller.done, 60.0, "the end of the run")
    assert controller.stamps == [TICK_NS * k for k in range(1, last + 1)]
    assert controller.truths == list(range(controller.truths[0], last + 1))
    assert controller.truths[0] <= 5  # connected beside the joints, in any order
    return controller.status


def point_of(message: object) -> tuple[float, float, float]:
    return message.x, message.y, message.z


@pytest.mark.untimed
def test_jitter_changes_nothing(ros_graph: RosGraph, rospy_node: str) -> None:
    calm = lockstep(ros_graph, 0.05, 50)
    nervous = lockstep(ros_graph, 0.05, 50, jitter_ms=5.0)
    assert calm.state_hash == nervous.state_hash


@pytest.mark.untimed
def test_the_package_steps_as_the_node_does(ros_graph: RosGraph, rospy_node: str) -> None:
    import numpy as np

    import surg_core
    from surg_sim.physics.sim_arm import ArmCommand
    from surg_sim.physics.world import World

    world = World(surg_core.load_cell(CELL))
    for _ in range(50):
        world.step({"PSM1": ArmCommand(velocity=np.array([0.05, 0, 0, 0, 0, 0]), jaw=0.3)})
    assert lockstep(ros_graph, 0.05, 50).state_hash == world.hash


def test_abort_names_who_is_missing(ros_graph: RosGraph, rospy_node: str) -> None:
    controller = Controller(0.0, 10_000, jaw=False)
    with running(ros_graph, controller, abort_timeout=1.5) as child:
        ros_graph.wait_for(lambda: child.exit_code is not None, 10.0, "the bridge to give up")
        log = child.log_tail(20)
    assert child.exit_code == 1
    assert "the controller of PSM1 has not answered tick 1 with tool/servo_jp" in log
    assert controller.repeats >= 3  # state 1 again, five times per time-out
    status = controller.status
    assert status.state == status.STATE_ABORTED and "PSM1" in status.detail


@pytest.mark.untimed
def test_a_stranger_is_not_taken_for_the_controller(ros_graph: RosGraph, rospy_node: str) -> None:
    """Who only looks at a topic must not start the run: the controller would miss its beginning."""
    controller = Controller(0.0, 50)
    (jaws,) = [topic for topic in controller.topics if topic.name == "/PSM1/tool/measured_js"]
    jaws.unregister()
    with running(ros_graph, controller, connect_timeout=6.0) as child:
        ros_graph.wait_for(lambda: bool(controller.status.state), 20.0, "the simulator")
        node = master.call(ros_graph.uri, "lookupNode", "/sim")
        stranger, _ = graph_probe.connect(node, "/PSM1/tool/measured_js")
        with stranger:
            ros_graph.wait_for(lambda: child.exit_code is not None, 20.0, "the bridge to give up")
        log = child.log_tail(20)
    assert child.exit_code == 1 and not controller.stamps
    assert "the controller does not subscribe /PSM1/tool/measured_js" in log


def test_free_run_keeps_its_rate_and_its_dead_man(ros_graph: RosGraph, rospy_node: str) -> None:
    controller = Controller(0.05, 10_000)
    with running(ros_graph, controller, mode="freerun"):
        ros_graph.wait_for(lambda: len(controller.stamps) > 600, 20.0, "600 ticks")
        # The stamps are the clock; a busy machine may cost this subscriber messages, never ticks.
        steps = np.diff(controller.stamps[:600])
        assert np.all(steps % 2_000_000 == 0)
        assert np.median(steps) == 2_000_000
        assert abs(controller.stamps[-1] / 1e9 - time.time()) < 1.0
        assert not controller.links[-1].dead_man and not controller.links[-1].lockstep
        controller.silent = True
        ros_graph.wait_for(lambda: controller.links[-1].dead_man, 5.0, "the dead-man")
        assert controller.status.deterministic is False


def test_faults_are_taken_on_the_loopback_only(ros_graph: RosGraph, rospy_node: str) -> None:
    """The same master under a name that is not the loopback's: the node does not start."""
    import socket

    uri = ros_graph.uri.replace("localhost", socket.gethostname())
    if uri == ros_graph.uri or "localhost" in uri:
        pytest.skip("this machine is called localhost")
    child = ros_graph.node(
        "surg_sim",
        "bridge_node.py",
        "/sim",
        {"cell": str(CELL), "inject": True},
        env={"ROS_MASTER_URI": uri},
    )
    ros_graph.wait_for(lambda: child.exit_code is not None, 60.0, "the bridge to refuse")
    assert child.exit_code == 2
    assert "loopback" in child.log_tail(20)


@pytest.mark.untimed
def test_faults_in_lockstep_are_one_hash_and_the_package_agrees(
    ros_graph: RosGraph, rospy_node: str
) -> None:
    """Losses, swaps, a frozen link, a lost tool and a moving trocar: node twice, package once."""
    import surg_core
    from surg_sim.nodes.fault_injector import Injector
    from surg_sim.nodes.faults import parse
    from surg_sim.physics.sim_arm import ArmCommand
    from surg_sim.physics.world import World

    faults = [
        {"fault": "wire", "topic": "robot/servo_jv", "loss": 0.2, "reorder": 0.2, "at": 5},
        {"fault": "freeze", "at": 40, "ticks": 20},
        {"fault": "tool_lost", "at": 50, "ticks": 30},
        {"fault": "trocar_motion", "at": 10, "amplitude": 0.005},
        {"fault": "trocar_jump", "at": 90, "offset": [0.001, 0, 0]},
    ]
    text = json.dumps(faults)
    hashes = [lockstep(ros_graph, 0.05, 120, faults=text).state_hash for _ in range(2)]
    world = World(surg_core.load_cell(CELL))
    injector = Injector(world, parse(text, world.arms))
    for tick in range(1, 121):
        lost = injector.tool_lost("PSM1")
        command = ArmCommand(velocity=np.array([0.05, 0, 0, 0, 0, 0]), jaw=None if lost else 0.3)
        injector.states("PSM1", tick)
        world.step(injector.commands({"PSM1": (tick, command)}))
    assert hashes == [world.hash] * 2
    assert lockstep(ros_graph, 0.05, 120, faults="").state_hash != world.hash


def test_inject_freezes_the_link_and_loses_the_tool_in_free_run(
    ros_graph: RosGraph, rospy_node: str
) -> None:
    import rospy
    from std_msgs.msg import String

    controller = Controller(0.0, 10_000)
    jaws: list[float] = []
    tool = rospy.Subscriber("/PSM1/tool/measured_js", rospy.AnyMsg, lambda _: jaws.append(0))
    inject = rospy.Publisher("/sim/inject", String, queue_size=10)
    with running(ros_graph, controller, mode="freerun", inject=True):
        ros_graph.wait_for(lambda: len(controller.stamps) > 100, 20.0, "100 ticks")
        ros_graph.wait_for(lambda: inject.get_num_connections() > 0, 5.0, "/sim/inject")
        inject.publish(String('{"fault": "gremlin"}'))
        inject.publish(String('[{"fault": "freeze", "ticks": 200}, {"fault": "tool_lost"}]'))
        ros_graph.wait_for(
            lambda: controller.status.faults == ["freeze", "tool_lost"], 5.0, "the faults"
        )
        ros_graph.wait_for(
            lambda: controller.status.faults == ["tool_lost"], 5.0, "the link's return"
        )
        seen = len(jaws)
        count = len(controller.stamps) + 50
        ros_graph.wait_for(lambda: len(controller.stamps) > count, 5.0, "further states")
        assert len(jaws) == seen
        # The link's own dead-man worked while the link was frozen.
        assert max(np.diff(controller.stamps)) >= 200 * TICK_NS
    tool.unregister()
    inject.unregister()


@pytest.mark.parametrize("stale", [0.0, 0.02])
def test_the_trocar_is_tracked_on_request(
    ros_graph: RosGraph, rospy_node: str, stale: float
) -> None:
    import rospy

    from surg_msgs.msg import GroundTruth, PointVelocityStamped, Ready

    controller = Controller(0.0, 300)
    ready: list[Ready] = []
    seen: dict[int, PointVelocityStamped] = {}
    truth: dict[int, tuple] = {}

    def on_truth(message: GroundTruth) -> None:
        truth[message.header.stamp.to_nsec()] = point_of(message.arms[0].trocar)

    subscribers = [
        rospy.Subscriber(
            "/PSM1/rcm/track",
            PointVelocityStamped,
            lambda m: seen.setdefault(m.header.stamp.to_nsec(), m),
        ),
        rospy.Subscriber("/sim/ground_truth/state", GroundTruth, on_truth),
        rospy.Subscriber("/sim/ready", Ready, ready.append),
    ]
    controller.watchers += subscribers[:2]
    motion = '{"fault": "trocar_motion", "amplitude": 0.005, "frequency": 0.25}'
    with running(ros_graph, controller, faults=motion, track_stale=stale):
        ros_graph.wait_for(lambda: controller.done, 30.0, "the end")
        last = max(truth)
        newest = last - round(stale * 1e9)
        ros_graph.wait_for(lambda: newest in seen, 5.0, "the last sample")
        assert max(seen) == newest
        samples = [(seen[t], truth[t]) for t in sorted(seen) if t in truth]
        assert len(samples) > 250
        for sample, point in samples:
            assert sample.header.frame_id == "PSM1_base"
            assert point_of(sample.point) == point

        def last_announced() -> int:
            return max((r.tick for r in ready if r.participant == "sim"), default=0)

        ros_graph.wait_for(lambda: last_announced() >= 300, 5.0, "the last Ready")
        # The tracker announces what it has sent, so that lock-step stays deterministic.
        announced = {r.tick: r.sent[0] for r in ready if r.participant == "sim"}
        assert max(announced) in (300, 301) and all(tick == n for tick, n in announced.items())
        moved = [sample.point.x for sample, _ in samples]
        assert max(moved) - min(moved) > 0.003
    subscribers[2].unregister()
    topics = {name for name, _ in rospy.get_published_topics()}
    assert "/PSM1/rcm/track" not in topics
