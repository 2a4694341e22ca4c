"""Lenses, hand-eye and bases of an endoscope in manifests and data sets."""
