"""Endoscopes: capture of pictures, and the calibration of lenses, hand-eye and bases.

Pure modules take arrays and return values; modules named `*_node.py` are the ROS nodes.
"""
