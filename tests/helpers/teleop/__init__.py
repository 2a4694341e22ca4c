"""Hands, devices and consoles for tests of teleoperation."""
