#!/usr/bin/env python3
"""Starts the node: rosrun surg_dvrk_compat dvrk_compat_node.py _arms:=PSM1."""

import sys

from surg_dvrk_compat.dvrk_compat_node import main

if __name__ == "__main__":
    sys.exit(main())
