"""Score cards of policies: their file, and their page."""
