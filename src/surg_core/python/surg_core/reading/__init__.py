"""Files that people and other programs write: text tables, and lenses in the forms of others."""
