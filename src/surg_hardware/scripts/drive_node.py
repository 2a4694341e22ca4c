#!/usr/bin/env python3
"""The drive of an instrument: rosrun surg_hardware drive_node.py _cell:=... _arm:=..."""

import sys

from surg_hardware.drive.drive_node import main

if __name__ == "__main__":
    sys.exit(main())
