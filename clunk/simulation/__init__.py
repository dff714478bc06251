"""A driveline under a load: matrices, modes, steady motion, single runs, their histories and energy, the small gap.

The package uses studies and the core, and knows nothing of maps and files.
"""
