"""Many drivelines prepared at once: the same study with other numbers, as arrays."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from clunk.core.channels import Channels
from clunk.core.exact.flows import Flows
from clunk.core.regimes import Each, System
from clunk.core.tile import Batch, batch_of
from clunk.simulation import driveline
from clunk.simulation.driveline import Driveline
from clunk.simulation.measures import channels_of
from clunk.study.arrays import Floats, Positions
from clunk.study.document import Place
from clunk.study.parameters import located
from clunk.study.study import Study, refuse_points, replace_values

MOST = 512  # drivelines of a batch: 14 MB of tables, and of each the share in 5 ms of interpreting is small
_MEASURED = 128  # of those whose channels are tabulated, which take some 100 KB each


def prepare_one(study: Study) -> Batch:
    """The switched linear system of a study, the tables of its method, and the channels of its measures, if any."""
    return _prepared(study, Driveline.from_study(study))


def _prepared(study: Study, line: Driveline) -> Batch:
    alone = batch_of(*driveline.prepare(study, line))
    return alone._replace(channels=_channels(study, line, alone.system, alone.each))


def _channels(study: Study, line: Driveline, system: System, each: Each) -> Channels | None:
    return channels_of(study, line, system, each) if study.measured else None


def prepare_many(study: Study, parameters: Sequence[str], values: Floats) -> Iterator[tuple[Positions, Batch]]:
    """The switched linear systems of a study with other values, and the tables of its method: see `driveline.prepare`.

    Yields batches of those that are alike but for numbers, each with the positions of its drivelines in `values`. The
    bits of each are those that it has alone.

    Parameters
    ----------
    parameters : of str
        Dotted keys.
    values : (D, parameters) float64, in the keys' units

    Raises
    ------
    ConfigError
        Where a value is not allowed, as `replace_values` does for the first such driveline.
    """
    if not values.size:
        return
    refuse_points(study, parameters, values)
    places = [located(study, parameter)[0] for parameter in parameters]
    varied = np.array([_is_size(place) for place in places])
    # what is no spring or damper where it is zero, and any other value, makes another kind of driveline
    _, group_of = np.unique(np.where(varied, values > 0.0, values), axis=0, return_inverse=True)
    for group in range(group_of.max(initial=-1) + 1):
        alike = np.flatnonzero(group_of.ravel() == group)
        first = replace_values(study, dict(zip(parameters, values[alike[0]].tolist(), strict=True)))
        most = _MEASURED if study.measured else MOST
        for begin in range(0, alike.size, most):
            part = alike[begin : begin + most]
            sizes = {place: values[part, k] for k, place in enumerate(places) if varied[k]}
            yield from ((part[some], batch) for some, batch in _prepare_alike(first, sizes, part.size))


def _is_size(place: Place) -> bool:
    """Whether a key is an inertia, or what makes a spring's stiffness or a damper's damping."""
    return place[:2] == ("driveline", "inertias") or (
        place[-1] in ("stiffness", "damping", "radius") and place[0] in ("driveline", "lash")
    )


def _prepare_alike(study: Study, sizes: dict[Place, Floats], count: int) -> Iterator[tuple[Positions, Batch]]:
    """Prepare drivelines that differ from a study's in some sizes only, each (count,)."""
    line = Driveline.from_study(study)
    lines = _with_sizes(study, line, sizes, count)
    if study.solver.method != "exact" or line.staged or line.frictions:
        for k in range(count):
            yield np.array([k]), _prepared(study, lines.of_batch(k))
        return
    system, flows = driveline.prepare(study, lines)
    assert isinstance(flows, Flows)
    each = Each._make(getattr(system, name) for name in Each._fields)
    first = system._replace(**{name: array[0] for name, array in zip(Each._fields, each, strict=True)})
    channels = _channels(study, lines, first, each)
    # what a step asks of a flow as a whole
    shapes = np.concatenate([flows.modal, flows.oscillating, flows.steady, flows.rolls], axis=1)
    _, shape_of = np.unique(shapes, axis=0, return_inverse=True)
    if not shape_of.any():
        yield np.arange(count), Batch(first, each, flows, channels)
        return
    for shape in range(shape_of.max() + 1):
        some = np.flatnonzero(shape_of.ravel() == shape)
        of_some = Each._make(array[some] for array in each)
        alike = first._replace(**{name: array[0] for name, array in zip(Each._fields, of_some, strict=True)})
        tables = Flows._make(table[some] for table in flows)
        yield some, Batch(alike, of_some, tables, None if channels is None else channels.at(some))


def _with_sizes(study: Study, line: Driveline, sizes: dict[Place, Floats], count: int) -> Driveline:
    """The batch of drivelines with other sizes, (count,) each."""

    def columns(places: Sequence[Place], values: npt.ArrayLike) -> Floats:
        batch = np.tile(np.asarray(values, np.float64), (count, 1))
        for k, place in enumerate(places):
            batch[:, k] = sizes.get(place, batch[:, k])
        return batch

    def of_shafts(key: str) -> list[Place]:
        return [("driveline", "shafts", k, key) for k in range(len(line.shafts))]

    def of_lashes(*keys: str) -> list[Place]:
        return [(*place, *keys) for place in study.lash_places]

    contacts = [lash.contact for lash in study.lashes]
    radii = columns(of_lashes("radius"), [lash.radius for lash in study.lashes])
    squares = np.array([[radius**2 for radius in row] for row in radii.tolist()])  # as Python rounds them
    return replace(
        line,
        inertia=columns([("driveline", "inertias", k) for k in range(line.inertia.size)], line.inertia),
        shaft_stiffness=columns(of_shafts("stiffness"), line.shaft_stiffness),
        shaft_damping=columns(of_shafts("damping"), line.shaft_damping),
        contact_stiffnesses=squares
        * columns(of_lashes("contact", "stiffness"), [each.stiffness or 0.0 for each in contacts]),
        contact_dampings=squares * columns(of_lashes("contact", "damping"), [each.damping or 0.0 for each in contacts]),
    )
