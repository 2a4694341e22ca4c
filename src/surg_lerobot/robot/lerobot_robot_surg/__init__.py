"""An arm of a running graph as a robot of LeRobot: ``--robot.type=surg_arm``."""

from lerobot_robot_surg.surg_arm import SurgArm, SurgArmConfig, connection

__all__ = ["SurgArm", "SurgArmConfig", "connection"]
