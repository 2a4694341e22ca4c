"""Drawn tools, postures and forces, with statics written out apart from the code under test."""
