"""Simulation-based calibration: whether the posterior covers what it claims, for one protocol."""
