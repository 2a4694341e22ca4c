"""Emulated controllers of Franka arms: FER (Panda) and FR3."""
