"""From an optimum to a posterior: sampling, redrawing, calibration nuisances, comparison, checks."""
