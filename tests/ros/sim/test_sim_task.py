"""The bridge with a task: its topics, and a person at the assistant's instrument in free-run."""

from __future__ import annotations

import time

import numpy as np
import pytest
import rospy
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty

from crtk_msgs.msg import OperatingState
from helpers.graph.ros import RosGraph
from surg_cli.graph.graph_probe import observe
from surg_cli.graph.topic_contract import compare, load
from surg_cli.host import paths
from surg_core import load_cell
from surg_core.contract import GRID
from surg_msgs.msg import SimStatus, TaskState
from surg_sim.nodes import bridge_messages
from surg_sim.physics.world import World
from surg_sim.tasks import load as load_task

pytestmark = pytest.mark.ros

CELL = paths.ROOT / "cells" / "sim_two_arms"
SHORT = paths.ROOT / "tests" / "helpers" / "sim" / "short_bgr.py"


def test_a_person_drives_the_assistant_and_the_task_ends(
    ros_graph: RosGraph, rospy_node: str
) -> None:
    states: list[TaskState] = []
    joints: list[np.ndarray] = []
    statuses: list[SimStatus] = []
    topics = [
        rospy.Subscriber("/sim/task_state", TaskState, states.append),
        rospy.Subscriber(
            "/assistant/measured_js", JointState, lambda m: joints.append(np.array(m.position))
        ),
        rospy.Subscriber("/sim/status", SimStatus, statuses.append),
        rospy.Publisher("/assistant/servo_jp", JointState, queue_size=0),
        rospy.Publisher("/assistant/jaw/servo_jp", JointState, queue_size=0),
    ]
    leader, jaw = topics[3], topics[4]
    params = {"cell": str(CELL), "mode": "freerun", "task": str(SHORT), "setting": "ex_vivo"}
    child = ros_graph.node("surg_sim", "bridge_node.py", "/sim", params)
    try:
        ros_graph.wait_for(
            lambda: child.exit_code is not None or len(joints) > 20, 20.0, "the assistant"
        )
        assert child.exit_code is None, child.log_tail()
        seen = observe(ros_graph.uri)
        wrong = compare(load(), seen, "PSM1", ("sim",), lockstep=False, parameters={"task"})
        # The contract speaks of one arm; this cell has two.
        assert [w for w in wrong if "/ECM/" not in w] == []

        start = joints[-1].copy()
        goal = start + np.array([0.05, -0.05, 0.01, 0.1])
        leader.publish(JointState(position=[1.0, 2.0]))  # unusable: said, and nothing happens
        leader.publish(JointState(position=[np.nan] * 4))
        end = time.monotonic() + 1.5
        while time.monotonic() < end:
            leader.publish(JointState(position=goal.tolist()))
            jaw.publish(JointState(position=[0.4]))
            time.sleep(0.05)
        print(f"from {start} to {joints[-1]}, asked for {goal}")
        assert np.allclose(joints[-1], goal, atol=[0.01, 0.01, 0.002, 0.02])

        ros_graph.wait_for(
            lambda: bool(statuses) and statuses[-1].state == SimStatus.STATE_DONE,
            20.0,
            "the end of the episode",
        )
        log = child.log_tail(100)
    finally:
        ros_graph.supervisor.stop([child])
        for topic in topics:
            topic.unregister()
    task = statuses[-1].task
    assert task.state == task.STATE_FAILURE
    assert (task.name, task.setting) == ("short_bgr", "ex_vivo")
    assert (task.phase, task.detail) == (states[-1].phase, states[-1].reason)
    assert "time limit of 3.5 s" in states[-1].reason
    assert [m.done for m in states] == [False] * (len(states) - 1) + [True]
    assert {m.tick % 25 for m in states[:-1]} == {0}
    assert states[-1].tick == 1751
    first, last = (bridge_messages.task_state(m.names, m.values) for m in (states[0], states[-1]))
    assert np.shape(last["nodes"]) == (36, 3)
    assert np.allclose(last["assistant_joints"], joints[-1], atol=1e-3)
    assert not np.allclose(first["assistant_joints"], last["assistant_joints"], atol=1e-3)
    assert "finite numbers" in log


@pytest.mark.full
def test_in_real_time_the_assistant_begins_once_the_arm_is_enabled(
    ros_graph: RosGraph, rospy_node: str
) -> None:
    """What it points at before that, nobody is there to see."""
    joints: list[np.ndarray] = []
    topics = [
        rospy.Subscriber(
            "/assistant/measured_js", JointState, lambda m: joints.append(np.array(m.position))
        ),
        rospy.Publisher("/PSM1/operating_state", OperatingState, queue_size=0, latch=True),
    ]
    state = topics[1]
    scene = {"cell": str(CELL), "task": "bgr"}
    params = {**scene, "mode": "freerun", "participants": ["assistant"]}
    children = [ros_graph.node("surg_sim", "bridge_node.py", "/sim", params)]
    params = {**scene, "after": ["PSM1"]}
    children.append(ros_graph.node("surg_sim", "expert_node.py", "/assistant", params))
    try:
        state.publish(OperatingState(state="DISABLED"))
        ros_graph.wait_for(
            lambda: bool(joints) and state.get_num_connections() == 1, 30.0, "the assistant"
        )
        rest = joints[-1]
        time.sleep(2.0)  # it reacts within 0.8 s
        assert np.ptp(joints, axis=0).max() < 1e-3
        state.publish(OperatingState(state="ENABLED"))
        ros_graph.wait_for(lambda: np.abs(joints[-1] - rest).max() > 0.02, 10.0, "its motion")
    finally:
        ros_graph.supervisor.stop(children)
        for topic in topics:
            topic.unregister()


def drawn(states: list[TaskState], seed: int) -> list[TaskState]:
    """Those of an episode."""
    return [state for state in states if state.seed == seed]


def test_people_who_try_again_have_no_time_limit(ros_graph: RosGraph, rospy_node: str) -> None:
    """With ``~endless`` the phase is still told behind the limit of 3.5 s; then comes another."""
    states: list[TaskState] = []
    topic = rospy.Subscriber("/sim/task_state", TaskState, states.append)
    again = rospy.Publisher("/sim/new_episode", Empty, queue_size=1)
    params = {"cell": str(CELL), "mode": "freerun", "task": str(SHORT), "endless": True}
    child = ros_graph.node("surg_sim", "bridge_node.py", "/sim", params)
    try:
        ros_graph.wait_for(
            lambda: child.exit_code is not None or bool(states and states[-1].tick > 1850),
            40.0,
            "3.7 s of the task",
        )
        assert child.exit_code is None, child.log_tail()
        again.publish()
        ros_graph.wait_for(lambda: states[-1].seed == 1, 20.0, "another episode")
        ros_graph.wait_for(lambda: len(states) > len(drawn(states, 0)) + 5, 20.0, "its states")
        assert child.exit_code is None, child.log_tail()
    finally:
        ros_graph.supervisor.stop([child])
        topic.unregister()
        again.unregister()
    assert {(m.done, m.reason) for m in states} == {(False, "")}
    assert states[-1].phase == "point"
    assert np.all(np.diff([m.tick for m in states]) == GRID), "no tick is left out or sent twice"
    for seed in (0, 1):  # each is the one that an environment begins with this seed
        alone = World(load_cell(CELL), seed, task=load_task(str(SHORT)))
        target = bridge_messages.task_state(states[0].names, drawn(states, seed)[0].values)
        assert target["target"] == alone.task.target
        assert np.abs(target["nodes"] - alone.task.bowel.nodes).max() < 2e-3, seed
