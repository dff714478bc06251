"""A driveline under a load: its matrices and steady motion, a single run, its histories, energy and linear view.

Knows a study and the core; nothing of maps and files.
"""
