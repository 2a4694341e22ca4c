"""The assistant's instrument as a virtual arm."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from surg_core.arm_view import ArmCommands, ArmState, TipPose
from surg_core.transforms import virtual_tip
from surg_teleop.follow.servo_instrument import ServoInstrument


def test_a_virtual_arm_is_the_simulators_assistant() -> None:
    """The simulator's own kinematics is the oracle for pose and joints."""
    pytest.importorskip("surg_sim.physics.assistant_arm")
    from helpers.sim.assistant_pose import forward

    arm = ServoInstrument("/teleop", np.eye(3))
    assert arm.view() is None
    rng = np.random.default_rng(2)
    for _ in range(100):
        joints = rng.uniform([-0.8, -0.8, 0.05, -3.0], [0.8, 0.8, 0.2, 3.0])
        arm = ServoInstrument("/teleop", np.eye(3))
        arm.joints(1.0, 0, joints)
        view = arm.view()
        assert view.p_set == pytest.approx(forward(joints)[:3, 3])
        assert (view.state, view.stream) == (ArmState.ENABLED, "/teleop")
        pose = TipPose(view.p_set, joints[3] + 0.1)
        asked = arm.convert(ArmCommands(servo_cp=pose, jaw=0.3, state="pause", claim=True))
        assert asked.servo_jp == pytest.approx(
            [*TipPose(view.p_set, 0.0).joints[:3], joints[3] + 0.1]
        )
        R = Rotation.from_quat(pose.q).as_matrix()
        assert forward(asked.servo_jp)[:3, :3] == pytest.approx(R)
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
