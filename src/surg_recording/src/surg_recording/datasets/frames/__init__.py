"""The frames of a data set: their grid, and every feature resampled to it."""
