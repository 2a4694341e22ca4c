"""Helpers of the tests of the gateway to ROS 2."""
