"""Sums over log tau, the Gaussian likelihood on them, and what the data can identify."""
