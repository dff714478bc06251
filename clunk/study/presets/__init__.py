"""Drivelines from the literature, as fragments of a config, and the starter config that `clunk init` writes."""
