"""Recorded motions, how they map onto an arm, and the operator that plays them."""
