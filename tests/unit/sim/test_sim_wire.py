"""The hand-packed messages against the generated classes, and the checked parameters."""

from __future__ import annotations

import io
import struct

import numpy as np
import pytest

from surg_core.contract import SECOND_NS
from surg_ros import link_messages
from surg_sim.nodes import bridge_messages
from surg_sim.nodes.sim_parameters import BridgeSettings, EndoscopeSettings
from surg_sim.physics.ground_truth import ArmTruth
from surg_sim.tasks import Verdict

rospy = pytest.importorskip("rospy")

from surg_ros import params  # noqa: E402

STAMP_NS = 1_795_000_000_123_456_789


def serialised(message: object) -> bytes:
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def test_joint_state() -> None:
    from sensor_msgs.msg import JointState

    rng = np.random.default_rng(3)
    for n in (1, 6, 7):
        names = [f"joint_{i}" for i in range(n)]
        position, velocity = rng.normal(size=n), rng.normal(size=n)
        data = link_messages.JointStateLayout(names).pack(9, STAMP_NS, position, velocity)
        message = JointState(name=names, position=list(position), velocity=list(velocity))
        message.header.seq = 9
        message.header.stamp = rospy.Time(*divmod(STAMP_NS, SECOND_NS))
        assert data == serialised(message)
        message.header.frame_id = "base"
        message.effort = [1.0]
        stamp_ns, p, v = link_messages.unpack_joint_state(serialised(message))
        assert stamp_ns == STAMP_NS
        assert np.array_equal(p, position) and np.array_equal(v, velocity)


def test_link_status() -> None:
    from surg_msgs.msg import LinkStatus

    message = LinkStatus(
        tick=2**40, condition=LinkStatus.STOPPED, command="joint_velocity", dead_man=True,
        lockstep=False, fault="no state", speed_scaling=0.5, rate=1,
    )  # fmt: skip
    message.header.seq = 2**40 & 0xFFFFFFFF
    message.header.stamp = rospy.Time(*divmod(STAMP_NS, SECOND_NS))
    message.last_command = rospy.Time(3, 4_000_000)
    says = link_messages.LinkSays(
        LinkStatus.STOPPED, "joint_velocity", 3_004_000_000, True, False, "no state", 0.5
    )
    assert says.pack(STAMP_NS, 2**40) == serialised(message)


def test_point_velocity() -> None:
    from surg_msgs.msg import PointVelocityStamped

    message = PointVelocityStamped()
    message.header.seq = 12
    message.header.stamp = rospy.Time(*divmod(STAMP_NS, SECOND_NS))
    message.header.frame_id = "PSM1_base"
    message.point.x, message.point.y, message.point.z = point = np.array([0.1, -0.2, 0.3])
    message.velocity.x, message.velocity.y, message.velocity.z = velocity = -0.1 * point
    frame = link_messages.text("PSM1_base")
    assert bridge_messages.pack_point_velocity(STAMP_NS, 12, frame, point, velocity) == serialised(
        message
    )


def test_ground_truth() -> None:
    from geometry_msgs.msg import Point, Vector3

    from surg_msgs.msg import ArmTruth as ArmTruthMessage
    from surg_msgs.msg import GroundTruth

    values = np.arange(21.0).reshape(7, 3)
    kinds = (Point, Vector3, Point, Vector3, Point, Point, Vector3)
    members = [kind(*row) for kind, row in zip(kinds, values, strict=True)]
    message = GroundTruth(tick=5, arms=[ArmTruthMessage(n, *members, 0.5) for n in ("PSM1", "A")])
    message.header.seq = 5
    message.header.stamp = rospy.Time(*divmod(STAMP_NS, SECOND_NS))
    truth = ArmTruth(*values, 0.5)
    data = bridge_messages.pack_ground_truth(STAMP_NS, 5, [("PSM1", truth), ("A", truth)])
    assert data == serialised(message)


def test_twist() -> None:
    from geometry_msgs.msg import TwistStamped

    message = TwistStamped()
    message.header.frame_id = "PSM1_base"
    message.header.stamp = rospy.Time(7, 8)
    message.twist.linear.y, message.twist.angular.z = 2.0, 6.0
    stamp_ns, twist = link_messages.unpack_twist(serialised(message))
    assert stamp_ns == 7_000_000_008
    assert twist.tolist() == [0, 2, 0, 0, 0, 6]


def test_garbage_is_refused_with_one_kind_of_error() -> None:
    rng = np.random.default_rng(4)
    refused = 0
    for _ in range(2000):
        data = rng.integers(0, 256, rng.integers(0, 80), dtype=np.uint8).tobytes()
        for read in (link_messages.unpack_joint_state, link_messages.unpack_twist):
            try:
                read(data)
            except struct.error:
                refused += 1
    print(f"{refused} of 4000 refused")
    assert refused > 3900


def test_settings_are_checked() -> None:
    def checked(kind: type, **given: object) -> object:
        return params.read(kind, {"cell": "cells/sim_ur5e", **given})

    settings = checked(BridgeSettings, participants="operator, expert", mode="freerun")
    assert settings.participants == ("operator", "expert")
    assert settings.mode == "freerun" and settings.arms == ()
    for kind, wrong in (
        (BridgeSettings, {"cell": ""}),
        (BridgeSettings, {"mode": "slow"}),
        (BridgeSettings, {"participants": 3}),
        (BridgeSettings, {"observers": ["nobody"]}),
        (BridgeSettings, {"seed": True}),
        (BridgeSettings, {"view": "yes"}),
        (BridgeSettings, {"connect_timeout": float("nan")}),
        (BridgeSettings, {"track_stale": 2}),
        (BridgeSettings, {"faults": ["freeze"]}),
        (BridgeSettings, {"inject": 1}),
        (EndoscopeSettings, {"width": 4000}),
        (EndoscopeSettings, {"vignette": 1}),
    ):
        with pytest.raises(params.ParamError, match=f"~{next(iter(wrong))}"):
            checked(kind, **wrong)


def test_task_state_round_trip() -> None:
    """Seeded states of any shapes: the bytes are the message's, the dictionary comes back."""
    from surg_msgs.msg import TaskState

    rng = np.random.default_rng(11)
    count = 0
    for tick in range(1, 40):
        shapes = [(), (3,), (int(rng.integers(1, 40)), 3), (4, 4), ()]
        rng.shuffle(shapes)
        state = {
            f"name_{i}": rng.normal(size=shape) if shape else float(rng.normal())
            for i, shape in enumerate(shapes)
        }
        layout = bridge_messages.TaskStateLayout(state)
        outcome = (bool(tick % 2), False, "lost, and \u201cgone\u201d" * (tick % 3))
        verdict = Verdict(*outcome, phase="retract", reward=0.25)
        data = layout.pack(STAMP_NS, tick, 7, state, verdict)
        message = TaskState().deserialize(data)
        assert serialised(message) == data
        assert (message.tick, message.seed, message.phase) == (tick, 7, "retract")
        assert message.reward == 0.25
        assert (message.done, message.success, message.reason) == outcome
        assert message.header.stamp.to_nsec() == STAMP_NS
        back = bridge_messages.task_state(message.names, message.values)
        assert list(back) == list(state)
        for name, value in state.items():
            assert np.shape(back[name]) == np.shape(value)
            assert np.array_equal(back[name], value)
            count += 1
    print(f"{count} entries")


def test_a_task_state_keeps_its_shape() -> None:
    layout = bridge_messages.TaskStateLayout({"p": np.zeros(3), "t": 1.0})
    for other in ({"p": np.zeros(4), "t": 1.0}, {"p": np.zeros(3)}, {"t": np.zeros(3), "p": 1.0}):
        with pytest.raises(ValueError, match="task's state was"):
            layout.pack(0, 1, 0, other, Verdict())
    for names, values in ((["p[3]"], [1.0, 2.0]), (["p[2]"], [1.0, 2.0, 3.0]), (["t"], [])):
        with pytest.raises(ValueError, match="values"):
            bridge_messages.task_state(names, values)


def test_wrench() -> None:
    from geometry_msgs.msg import WrenchStamped

    message = WrenchStamped()
    message.header.seq, message.header.frame_id = 9, "PSM1_base"
    message.header.stamp = rospy.Time(*divmod(STAMP_NS, SECOND_NS))
    message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = 1.5, -2.0, 0.25
    frame = link_messages.text("PSM1_base")
    data = bridge_messages.pack_wrench(STAMP_NS, 9, frame, np.array([1.5, -2.0, 0.25]))
    assert data == serialised(message)
