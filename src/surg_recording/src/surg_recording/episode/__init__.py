"""Episode folders: reading, writing, finishing and recovering them."""
