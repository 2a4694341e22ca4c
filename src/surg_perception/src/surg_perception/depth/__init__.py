"""Rectified pictures of both eyes, and the depth of what they see."""
