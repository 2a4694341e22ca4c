"""Made-up recordings and independent readers."""
