"""Endoscope guidance: the task and its scripted senders."""
