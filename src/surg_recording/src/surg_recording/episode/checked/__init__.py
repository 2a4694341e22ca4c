"""Recordings read for computing: cut to what may be used, and every table checked."""
