"""Emulated arms: controllers that refuse what the arm refuses."""
