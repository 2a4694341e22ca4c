#!/usr/bin/env python3
"""Hands on the controls of a cell: rosrun surg_teleop teleop_node.py _cell:=... _leader:=..."""

import sys

from surg_teleop.follow.teleop_node import main

if __name__ == "__main__":
    sys.exit(main())
