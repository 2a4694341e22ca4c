"""Readers of the source tree."""
