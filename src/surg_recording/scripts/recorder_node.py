#!/usr/bin/env python3
"""Entry point of the recorder node."""

import sys

from surg_recording.nodes.recorder_node import main

sys.exit(main())
