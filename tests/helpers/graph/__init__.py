"""Helpers of tests that start ROS graphs."""
