"""Measurements on a user's device: its link, its force constant, its damping."""
