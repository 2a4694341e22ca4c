"""Commands that bring recordings in, or mend them."""
