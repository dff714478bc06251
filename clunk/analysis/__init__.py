"""Analyses: thresholds, boundaries, sensitivity, optimisation, fits, and comparison of maps, methods, measurements."""
