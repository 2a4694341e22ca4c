"""Connects a policy to the platform's model server: no ROS, Python 3.8 to 3.13."""

__version__ = "0.1.0"
