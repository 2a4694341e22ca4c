"""Runs the course of examples."""
