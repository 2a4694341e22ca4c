"""What a hand says through its leader, and how late it was on its way."""
