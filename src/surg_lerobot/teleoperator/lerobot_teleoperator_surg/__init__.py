"""A LeRobot hand for an arm of a running graph: ``--teleop.type=surg_hand``."""

from lerobot_teleoperator_surg.surg_hand import SurgHand, SurgHandConfig

__all__ = ["SurgHand", "SurgHandConfig"]
