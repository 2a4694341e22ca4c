#!/usr/bin/env python3
"""Starts the node /sim: rosrun surg_sim bridge_node.py _cell:=cells/sim_ur5e _mode:=freerun."""

import sys

from surg_sim.nodes.bridge_node import main

if __name__ == "__main__":
    sys.exit(main())
