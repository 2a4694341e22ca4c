"""Calibration of lenses, stereo pose, hand-eye and bases from views of a printed board. Pure."""
