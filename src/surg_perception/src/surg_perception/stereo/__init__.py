"""The live node: rectified pictures, depth, points and marks of the endoscope."""
