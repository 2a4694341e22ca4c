"""What a calibration leaves for people and for other programs."""
