"""Whether hand and picture agree: the tip moves along the camera's axes, and the pictures decide.

``probe_moves`` states where the tip goes, ``tip_tracker`` finds it in the pictures, and
``registration_verdict`` judges.
"""
