"""Bundled leaders, one file each; found by the file's name (``surg_teleop.leader.load``)."""
