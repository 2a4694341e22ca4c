"""Policies, servers and made-up training data for tests."""
