"""A test that hangs fails by itself."""

from helpers.hardware.time_limit import time_limit

__all__ = ["time_limit"]
