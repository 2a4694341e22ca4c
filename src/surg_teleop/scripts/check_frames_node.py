#!/usr/bin/env python3
"""Whether hand and picture agree: rosrun surg_teleop check_frames_node.py _cell:=... _out:=..."""

import sys

from surg_teleop.frames.check_frames_node import main

if __name__ == "__main__":
    sys.exit(main())
