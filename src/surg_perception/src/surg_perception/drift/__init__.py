"""Whether the endoscope still looks where its calibration says."""
