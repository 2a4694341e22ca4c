#!/usr/bin/env python3
"""Publishes a gamepad, pedals, a SpaceMouse: rosrun surg_teleop leader_node.py."""

import sys

from surg_teleop.leaders.leader_node import main

if __name__ == "__main__":
    sys.exit(main())
