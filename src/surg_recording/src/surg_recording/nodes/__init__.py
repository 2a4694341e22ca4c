"""The recorder node and the clock monitor."""
