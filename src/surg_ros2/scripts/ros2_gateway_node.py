#!/usr/bin/env python3
"""Starts the node: rosrun surg_ros2 ros2_gateway_node.py _contract:=docs/reference/topics.yaml."""

import sys

from surg_ros2.ros2_gateway_node import main

if __name__ == "__main__":
    sys.exit(main())
