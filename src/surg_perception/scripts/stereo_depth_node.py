#!/usr/bin/env python3
"""Starts the node /eyes: rosrun surg_perception stereo_depth_node.py _cell:=cells/sim_two_arms."""

import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads that wait for one another burn a core

from surg_perception.stereo.stereo_depth_node import main

if __name__ == "__main__":
    sys.exit(main())
