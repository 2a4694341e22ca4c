"""Search for the bases and home postures of two arms round one patient."""
