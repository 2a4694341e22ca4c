"""Videos of an episode: encoding, reading, repair, and their lag."""
