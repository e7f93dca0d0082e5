"""Identified tissues in the languages of other programs."""
