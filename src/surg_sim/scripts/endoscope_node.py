#!/usr/bin/env python3
"""Starts the node /endoscope: rosrun surg_sim endoscope_node.py _cell:=cells/sim_ur5e."""

import sys

from surg_sim.nodes.endoscope_node import main

if __name__ == "__main__":
    sys.exit(main())
