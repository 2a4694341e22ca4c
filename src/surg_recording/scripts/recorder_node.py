#!/usr/bin/env python3
"""Entry point of the recorder node."""

import sys

from surg_recording.recorder_node import main

sys.exit(main())
