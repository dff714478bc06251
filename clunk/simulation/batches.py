"""Many drivelines prepared at once: the same study with other numbers, as arrays."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import repeat

import numpy as np
import numpy.typing as npt

from clunk.core.exact.flows import Flows
from clunk.core.regimes import OF_EACH, System
from clunk.core.rk4.propagator import Steps
from clunk.simulation import driveline
from clunk.simulation.driveline import Driveline
from clunk.study.document import Place
from clunk.study.parameters import located
from clunk.study.study import Study, refuse_points, replace_values

FloatArray = npt.NDArray[np.float64]

MOST = 512  # drivelines of a batch: 14 MB of tables, and of each the share in 5 ms of interpreting is small


def prepare_many(study: Study, parameters: Sequence[str], values: FloatArray) -> list[tuple[System, Steps | Flows]]:
    """The switched linear systems of a study with other values, and the tables of its method: see `driveline.prepare`.

    The bits of each are those that it has alone.

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
    refuse_points(study, parameters, values)
    places = [located(study, parameter)[0] for parameter in parameters]
    varied = np.array([_is_size(place) for place in places])
    # what is no spring or damper where it is zero, and any other value, makes another kind of driveline
    kinds = np.where(varied, values > 0.0, values)
    _, kind_of = np.unique(kinds, axis=0, return_inverse=True)
    prepared: dict[int, tuple[System, Steps | Flows]] = {}
    for kind in range(kind_of.max(initial=-1) + 1):
        alike = np.flatnonzero(kind_of.ravel() == kind)
        for begin in range(0, alike.size, MOST):
            part = alike[begin : begin + MOST]
            first = replace_values(study, dict(zip(parameters, values[part[0]].tolist(), strict=True)))
            sizes = {place: values[part, k] for k, place in enumerate(places) if varied[k]}
            prepared |= zip(part.tolist(), _prepare_alike(first, sizes, part.size), strict=True)
    return [prepared[k] for k in range(len(values))]


def _is_size(place: Place) -> bool:
    """Whether a key is an inertia, or what makes a spring's stiffness or a damper's damping."""
    return place[:2] == ("driveline", "inertias") or (
        place[-1] in ("stiffness", "damping", "radius") and place[0] in ("driveline", "lash")
    )


def _prepare_alike(study: Study, sizes: dict[Place, FloatArray], count: int) -> list[tuple[System, Steps | Flows]]:
    """Prepare drivelines that differ from a study's in some sizes only, each (count,)."""
    line = Driveline.from_study(study)
    lines = _with_sizes(study, line, sizes, count)
    if study.solver.method != "exact" or line.staged or line.frictions:
        return [driveline.prepare(study, lines.of_batch(k)) for k in range(count)]
    system, flows = driveline.prepare(study, lines)
    assert isinstance(flows, Flows)
    fields = (field if name in OF_EACH else repeat(field) for name, field in zip(system._fields, system, strict=True))
    return list(
        zip(map(System._make, zip(*fields, strict=False)), map(Flows._make, zip(*flows, strict=True)), strict=True)
    )


def _with_sizes(study: Study, line: Driveline, sizes: dict[Place, FloatArray], count: int) -> Driveline:
    """The batch of drivelines with other sizes, (count,) each."""

    def columns(places: Sequence[Place], values: npt.ArrayLike) -> FloatArray:
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
        contact_stiffnesses=squares * columns(of_lashes("contact", "stiffness"), [each.stiffness for each in contacts]),
        contact_dampings=squares * columns(of_lashes("contact", "damping"), [each.damping for each in contacts]),
    )
