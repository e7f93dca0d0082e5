"""From sums to an identified tissue: search, Levenberg-Marquardt, model choice, relaxation table."""
