#!/usr/bin/env python3
"""Starts the node."""

import sys

from surg_policy_bridge.nodes.model_server_node import main

if __name__ == "__main__":
    sys.exit(main())
