"""Videos of an episode: encoding, reading, mending, and how late they are."""
