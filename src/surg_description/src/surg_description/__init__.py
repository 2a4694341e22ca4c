"""Robots and instruments as files, and the generator that writes a cell from them."""
