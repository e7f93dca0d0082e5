"""Protocols of indentations, with one setting of the load channel, for a precision in the least time."""
