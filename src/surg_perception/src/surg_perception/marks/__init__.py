"""Marks of instruments in the endoscope's pictures, from joints and calibration alone."""
