"""What every Python node needs: the topics of arms and leaders, parameters, lock-step.

A ROS library: pure modules of other packages do not import it. The values that its ports exchange
(`surg_core.arm_view`) need no ROS.
"""
