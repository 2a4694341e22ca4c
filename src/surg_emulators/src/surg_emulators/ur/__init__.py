"""An emulated controller of a UR e-Series arm."""
