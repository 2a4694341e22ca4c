"""The bundled stereo methods."""
