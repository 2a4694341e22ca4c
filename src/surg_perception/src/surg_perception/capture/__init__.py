"""Capture of endoscope pictures: layouts, pairs, clocks, signal; the node is `capture_node`."""
