"""Laws, a file for each kind; those that a file lists in ``LAWS`` are known."""
