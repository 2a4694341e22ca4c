"""Peg transfer: the task and its scripted sender."""
