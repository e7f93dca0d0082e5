"""Measures of a hand in a guided session: nearness, straightness, speed, smoothness."""
