"""Version of the package, which a client tells the server."""

__version__ = "0.1.0"
