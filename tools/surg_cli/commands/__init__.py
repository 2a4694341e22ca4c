"""One module per command of `./surg`."""
