#!/usr/bin/env python3
"""Plays a motion file into an arm: rosrun surg_teleop operator_node.py _cell:=... _motion:=..."""

import sys

from surg_teleop.playback.operator_node import main

if __name__ == "__main__":
    sys.exit(main())
