#!/usr/bin/env python3
"""Starts the node /eyes: rosrun surg_perception eyes_node.py _cell:=cells/sim_two_arms."""

import sys

from surg_perception.eyes.eyes_node import main

if __name__ == "__main__":
    sys.exit(main())
