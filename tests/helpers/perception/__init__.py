"""Endoscopes for tests of capture and calibration."""
