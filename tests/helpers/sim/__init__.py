"""Tasks and scenes for tests of the simulator."""
