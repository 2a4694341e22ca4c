"""A hand on an arm: states, mapping, safety checks, and the node that wires them."""
