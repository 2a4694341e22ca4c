"""Simulated force sensors: a sensor between flange and tool, and its bench."""
