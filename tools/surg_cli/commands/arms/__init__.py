"""Commands about single arms: what they reach, how they follow."""
