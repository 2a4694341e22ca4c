"""The link to Universal Robots' e-Series: RTDE, dashboard, and the program on the robot."""
