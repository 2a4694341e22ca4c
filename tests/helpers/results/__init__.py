"""Writers of pages in docs/results."""
