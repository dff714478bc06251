"""Regime maps made of labels and numbers, of which nothing was run."""

from dataclasses import replace

import numpy as np

from clunk.results.maps import Results
from clunk.results.quantities import REGIME_QUANTITIES

CELL_QUANTITIES = {name: each for name, each in REGIME_QUANTITIES.items() if not each.dimension}
IMPACT_QUANTITIES = {name: each for name, each in REGIME_QUANTITIES.items() if each.dimension}


def map_of(axes, labels, sequence, *, title="Map", config="", digest="", attributes=None, **arrays):
    """A map whose other numbers, but for these arrays, are plain; of a failed cell there is no severity."""
    sequence = np.asarray(sequence, np.int16)
    shape, failed = sequence.shape, sequence < 0
    impacts = int(np.sum(arrays.get("primary_impacts", 0)))
    plain = {
        "sequence": sequence,
        "severity": np.where(failed, np.nan, 1.0),
        "approach_velocity": np.ones(shape),
        "last_event_time": np.full(shape, 0.5),
        "primary_impacts": np.zeros(shape, np.int32),
        "touches": np.full(shape, 3, np.int32),
        "status": np.where(failed, 3, 0).astype(np.uint8),
        "quality": np.ones(shape, np.uint8),
        "initial_side": -np.ones(shape, np.int8),
        "margin": np.where(failed, np.nan, 0.1),
        "impact_time": np.ones(impacts),
        "impact_flank": np.ones(impacts, np.int8),
        "impact_closing_speed": np.ones(impacts),
        "impact_severity": np.ones(impacts),
    }
    return Results(
        title=title,
        axes=tuple(axes),
        labels=tuple(labels),
        config=config,
        config_digest=digest,
        attributes=attributes or {},
        arrays=plain | arrays,
    )


def with_arrays(results, **arrays):
    """The map with other values of some quantities."""
    return replace(results, arrays={**results.arrays, **arrays})
