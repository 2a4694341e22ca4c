"""Views of the calibration board from a running system."""
