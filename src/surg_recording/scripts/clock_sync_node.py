#!/usr/bin/env python3
"""Entry point of the clock monitor."""

import sys

from surg_recording.clock_sync_node import main

sys.exit(main())
