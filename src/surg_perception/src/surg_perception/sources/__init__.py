"""Sources of endoscope pictures, one module per kind of URI (`capture.picture_source`)."""
