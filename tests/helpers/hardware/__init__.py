"""Helpers of the tests of links and emulated arms."""
