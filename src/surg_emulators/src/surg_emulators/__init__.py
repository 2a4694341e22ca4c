"""Emulated controllers of UR and Franka arms: they refuse what the arm refuses."""
