"""The commands that look at single episodes."""
