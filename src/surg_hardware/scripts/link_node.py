#!/usr/bin/env python3
"""The link to a real arm: rosrun surg_hardware link_node.py _cell:=... _arm:=..."""

import sys

from surg_hardware.link_node import main

if __name__ == "__main__":
    sys.exit(main())
