"""Drivelines from the literature, as fragments of a config, and the starter configs that `clunk init` writes."""
