#!/usr/bin/env python3
"""The operator console in the browser: rosrun surg_console console_node.py _cell:=..."""

import sys

from surg_console.ros.console_node import main

if __name__ == "__main__":
    sys.exit(main())
