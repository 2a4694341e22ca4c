"""Whether hand and picture agree: the tip is moved along the camera's axes, the pictures decide.

``moves`` says where the tip goes, ``sight`` finds it in the pictures, ``judge`` says what follows.
"""
