#!/usr/bin/env python3
"""Plays a sender of a task: rosrun surg_sim expert_node.py __name:=expert _cell:=... _task:=bgr."""

import sys

from surg_sim.nodes.expert_node import main

if __name__ == "__main__":
    sys.exit(main())
