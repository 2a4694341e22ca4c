#!/usr/bin/env python3
"""Starts the node /endoscope: rosrun surg_perception capture_node.py _source:=... _layout:=sbs."""

import sys

from surg_perception.capture.capture_node import main

if __name__ == "__main__":
    sys.exit(main())
