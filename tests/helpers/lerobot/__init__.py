"""The newest lerobot with our plug-ins, and what its user has besides."""
