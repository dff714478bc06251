"""Maps and their files: the quantities of a cell, the results file both ways, xarray datasets.

Knows what a sweep found, not how it was run.
"""
