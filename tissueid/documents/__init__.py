"""Documents: what is written to files and printed by ``--json``, as types."""
