"""Thousands of planar cars at once, each in a world of its own, on processor or GPU."""
