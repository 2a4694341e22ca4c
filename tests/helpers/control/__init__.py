"""Arms, links and reference laws for tests of the controller."""
