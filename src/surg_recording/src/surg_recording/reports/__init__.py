"""Numbers, figures and pages made from episodes."""
