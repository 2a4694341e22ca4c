"""Recorded motions, how they map onto an arm, and the node that plays them."""
