"""Bowel grasping and retraction: the task and its scripted senders."""
