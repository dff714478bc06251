"""Maps and their files: the quantities of a cell, writing and reading of results files, xarray datasets.

This package knows the results of a sweep, not how it was run.
"""
