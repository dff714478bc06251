"""Drivelines prepared many at a time have the bits that each has alone, and the same errors."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from helpers import reference
from helpers.randomplants import element_plant
from helpers.reference import Plant
from helpers.studies import random_study

import clunk
from clunk.core import tile
from clunk.core.exact.flows import Flows
from clunk.core.regimes import VARYING
from clunk.simulation import batches
from clunk.study.config import study_from_text
from clunk.study.designs import design_of_points
from clunk.study.parameters import located, parameters
from clunk.study.rules import count_of_flows, count_of_regimes
from clunk.study.study import replace_values
from clunk.sweeping.cells import Grid, leaves_system
from clunk.sweeping.reduction import Reduction

CRITICAL = Plant(
    inertias=(0.02, 0.01),
    shafts=((1, "ground", 2.0, 0.4), (2, "ground", 3.0, 0.1)),
    lash=(1, 2),
    contact_damping=0.6,
    acceleration_of=1,
)  # whose first inertia alone is critically damped by 0.4 N m s/rad


def prepared_of(study, points):
    """Systems and tables by the positions of their points."""
    many = batches.prepare_many(study, list(points), np.column_stack(list(points.values())))
    return {k: batch.at([n]) for positions, batch in many for n, k in enumerate(positions.tolist())}


def first_of(batch):
    """Tables of the first driveline of a batch by the exact method, or of the one by RK4."""
    return Flows._make(table[0] for table in batch.tables) if isinstance(batch.tables, Flows) else batch.tables


def same_as_alone(study, points):
    """Assert that all arrays of all systems and tables are the same, to the last bit and the layout."""
    for k, prepared in prepared_of(study, points).items():
        alone = batches.prepare_one(replace_values(study, {key: float(column[k]) for key, column in points.items()}))
        for one, other in ((alone.system, prepared.system), (first_of(alone), first_of(prepared))):
            for name in one._fields:
                expected, field = np.asarray(getattr(one, name)), np.asarray(getattr(other, name))
                assert np.array_equal(expected, field, equal_nan=expected.dtype.kind == "f"), (k, name)
                assert expected.dtype == field.dtype, (k, name)
                assert not field.size or expected.strides == field.strides, (k, name)


def sizes_of(study):
    """Parameters of a study that a batch takes as arrays, with their values; a staged shaft has no one stiffness."""
    shafts, inertias = range(1, len(study.driveline.shafts) + 1), range(1, len(study.driveline.inertias) + 1)
    keys = [f"driveline.inertias[{k}]" for k in inertias]
    keys += [f"driveline.shafts[{k}].{key}" for k in shafts for key in ("stiffness", "damping")]
    keys += ["lash.contact.stiffness", "lash.contact.damping", "lash.radius"]
    sizes = {}
    for key in keys:
        with suppress(clunk.ConfigError):
            sizes[key] = located(study, key)[2]
    return {key: size for key, size in sizes.items() if np.ndim(size) == 0}


def points_of(study, seed, count):
    """Values of all sizes, `count` each, within 30 % of a study's; the last of them without any damping."""
    random, points = np.random.default_rng(seed), {}
    for key, value in sizes_of(study).items():
        factors = random.uniform(0.7, 1.3, count)
        factors[0] = 1.0
        factors[-1] = "damping" not in key
        points[key] = value * factors
    return points


@pytest.mark.parametrize("restitution", [None, 0.4])
def test_tables_that_are_made_once_are_those_of_each(restitution):
    """Frictions and restitution are in no flow; some of the drivelines differ in an inertia, too."""
    study = study_from_text(reference.config_of(element_plant(3, 1, 1, 2, restitution), method="exact", end_time=0.3))
    number = 1 + next(k for k, shaft in enumerate(study.driveline.shafts) if shaft.friction > 0.0)
    frictions = {f"driveline.shafts[{number}].friction": np.linspace(0.1, 0.4, 9)}
    bouncing = {} if restitution is None else {"lash.contact.restitution": np.linspace(0.2, 0.6, 9)}
    same_as_alone(study, {**frictions, **bouncing})
    same_as_alone(study, {**frictions, **bouncing, "driveline.inertias[1]": np.repeat([0.01, 0.02, 0.015], 3)})


MEASURES = [
    'impacts.quantities=["impulse", "peak_torque", "energy"]',
    'measures=[{name="play", quantity="twist", of="lash 1", reduce="peak-to-peak"}]',
]
RANDOM = [(seed, staged, frictions, rigid) for seed, (staged, frictions, rigid) in enumerate(
    [(0, 0, None), (0, 0, 0.5), (1, 0, None), (0, 2, None), (1, 1, 0.5)] * 3)]  # fmt: skip


@pytest.mark.parametrize(("seed", "staged", "frictions", "restitution"), RANDOM)
def test_random_drivelines_side_by_side_have_the_bits_that_each_has_alone(seed, staged, frictions, restitution):
    """Tables, events, results and measures: of stages and frictions, by gap, force or impulse, under any load."""
    plant = element_plant(seed, 1, staged, frictions, restitution)
    study = study_from_text(reference.config_of(plant, method="exact", end_time=0.3), overrides=MEASURES)
    points = points_of(study, seed, 12)
    same_as_alone(study, points)
    grid, many, stop = Grid(study, design_of_points(study, points)), np.arange(12), np.zeros(1, "u1")
    together, alone = Reduction(grid), Reduction(grid)
    together.add(grid.run(many, stop))
    for k in many:
        alone.add(grid.run(many[k : k + 1], stop))
    for side_by_side, one_by_one in zip(together.collected(), alone.collected(), strict=True):
        for name, column in side_by_side.items():
            assert column.tobytes() == one_by_one[name].tobytes(), name
    _, events = grid.logged(points, 12)
    for k in many:
        _, of_alone = grid.logged({key: column[k : k + 1] for key, column in points.items()}, 1)
        assert of_alone.tobytes() == events[k : k + 1, : of_alone.shape[1]].tobytes()


MANY_FLOWS = """
[driveline]
inertias = [0.3, 0.006, 0.007, 1.8, 0.004, 0.007, 0.015]
shafts = [
    {between = [1, 2], stiffness = [840.0, 220.0, 840.0], breakpoints_deg = [-1.0, 3.0], damping = 0.1, friction = 2.0},
    {between = [1, 5], stiffness = 770.0, damping = 0.1, friction = 2.1},
    {between = [2, 6], stiffness = 800.0, damping = 0.04},
    {between = [3, 7], stiffness = 240.0, damping = 0.1},
]
[[lash]]
between = [2, 3]
backlash_deg = 6.0
radius = 0.04
contact = {stiffness = 4.8e7, damping = 1.1e4}
[[lash]]
between = [3, 4]
backlash_deg = 4.4
radius = 0.05
contact = {stiffness = 7.7e6, damping = 300.0}
[load]
initial_torque = 68.0
final_torque = 7.0
"""  # 48 flows of 14 states: 2.8 MB of tables


def test_the_memory_that_many_drivelines_take_at_once_is_bounded_however_many_flows_they_have():
    study = study_from_text(MANY_FLOWS, overrides=["solver.method='exact'"])
    values = np.linspace(0.002, 0.01, 60)[:, None]
    sizes = []
    for positions, batch in batches.prepare_many(study, ["driveline.inertias[2]"], values):
        sizes.append(positions.size)
        varying = [getattr(batch.systems, name) for name in VARYING]
        assert sum(array.nbytes for array in (*varying, *batch.tables)) < 1e8  # bytes, of 60 it would be 1.7e8
    assert sum(sizes) == 60
    grid = Grid(study, design_of_points(study, {"driveline.inertias[2]": values[:, 0]}))
    assert sum(1 for _ in grid.drivelines(values)) == len(sizes)
    assert len(grid._kept) <= 2 * max(sizes)


@pytest.mark.parametrize("seed", range(12))
def test_the_rules_count_the_regimes_that_there_are(seed):
    study = random_study(seed)
    system = batches.prepare_one(study).system
    assert system.regimes.size == count_of_regimes(study)
    assert len(system.rates) <= count_of_flows(study)


def test_of_drivelines_about_critical_damping_each_is_what_it_is_alone():
    study = reference.study_of(CRITICAL)
    dampings = np.array([0.3, 0.4, 0.5, 0.4 + 1e-12, 0.0, 3.0])
    same_as_alone(study, {"driveline.shafts[1].damping": dampings})
    tables = prepared_of(study, {"driveline.shafts[1].damping": dampings})
    assert [int(tables[k].tables.modal[0, 0]) for k in range(dampings.size)] == [1, 0, 1, 0, 1, 1]


CONFIGS = sorted(path.name for path in Path("configs").glob("*.toml"))


@pytest.mark.parametrize("method", ["exact", "rk4"])
@pytest.mark.parametrize("config", CONFIGS)
def test_values_of_any_key_of_any_config_are_prepared_together_with_the_bits_that_each_has_alone(config, method):
    study = clunk.load_study(f"configs/{config}", [f"solver.method='{method}'"])
    study, factors, points = study.model_copy(update={"sweep": None, "fit": None}), np.array([1.01, 1.02, 1.03]), {}
    for key in parameters(study.model_dump(exclude_none=True)):
        with suppress(clunk.ConfigError):  # a shaft with stages has no one stiffness
            _, known, value = located(study, key)
            if not known.whole and value != 0.0 and np.isfinite(value) and not leaves_system(study, key):
                points[key] = value * factors
    for key, column in points.items():
        batches_of_key = [*batches.prepare_many(study, [key], column[:, None])]
        assert len(batches_of_key) == (1 if method == "exact" else 3), key
    same_as_alone(study, points)


@pytest.mark.parametrize(("method", "kernel"), [("exact", tile.by_exact), ("rk4", tile.by_rk4)])
def test_every_driveline_is_run_by_the_same_machine_code(method, kernel):
    """numba compiles a kernel again, for half a minute, where one of its arrays has another type or order."""
    for seed in range(8):  # of 3 to 8 inertias, one to three lashes
        study = random_study(seed, f'solver.method = "{method}"', "solver.end_time = 0.01")
        clunk.simulate(study)
        clunk.sweep(study, boundaries=False)
    assert len(kernel.signatures) == 1


def test_breakpoints_that_cross_are_refused_though_each_value_is_sound():
    study = clunk.load_study("configs/clutch_damper.toml", ["solver.method='exact'"])
    keys = [f"driveline.shafts[1].breakpoints_deg[{k}]" for k in (1, 2)]
    low, high = (located(study, key)[2] for key in keys)
    crossed = np.array([[low, high], [high + 1.0, high], [high + 1.0, high + 2.0]])
    with pytest.raises(clunk.ConfigError, match="breakpoint"):
        list(batches.prepare_many(study, keys, crossed))
