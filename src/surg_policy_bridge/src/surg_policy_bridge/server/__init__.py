"""The model server: sessions, safety controller, play-out, and its node."""
