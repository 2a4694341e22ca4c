"""Leaders: what a hand holds, as a stream of samples."""
