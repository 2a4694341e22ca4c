#!/usr/bin/env python3
"""Entry point of the clock monitor."""

import sys

from surg_recording.nodes.clock_sync_node import main

sys.exit(main())
