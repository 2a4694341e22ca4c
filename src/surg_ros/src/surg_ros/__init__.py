"""What every Python node needs: the ports of an arm, lock-step, and fast transport.

A ROS library: pure modules of other packages do not import it. The values that its ports exchange
(`surg_core.arm_view`) need no ROS.
"""
