"""Policies that are cloned from demonstrations of any task, and what all learned policies share."""
