"""Identified tissues beside each other: whether they differ, by how much, and whether a hand could tell."""
