"""`./surg episode …`: what is done with recorded episodes."""
