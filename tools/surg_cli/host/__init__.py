"""The machine: packages, environment, build, terminal, cells on disk."""
