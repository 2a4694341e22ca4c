"""Endoscopes: capture, calibration of lenses, hand-eye and bases, depth and marks.

Pure modules take arrays and return values; modules named `*_node.py` are the ROS nodes.
"""
