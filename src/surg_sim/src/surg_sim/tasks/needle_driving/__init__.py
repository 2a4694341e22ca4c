"""Needle driving: the task, its board, its needle and its scripted sender."""
