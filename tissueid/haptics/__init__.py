"""Devices that are felt, and the one guard through which every force passes."""
