#!/usr/bin/env python3
"""The forces at tip and trocar: rosrun surg_hardware force_node.py _cell:=... _arm:=..."""

import sys

from surg_hardware.force.force_node import main

if __name__ == "__main__":
    sys.exit(main())
