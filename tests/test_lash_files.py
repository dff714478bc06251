"""Results of several lashes: their axis in memory, in files and in exports, and the map of each lash alone."""

import csv
from dataclasses import replace

import h5py
import numpy as np
import pytest
from scipy.io import loadmat

import clunk
from clunk.results import export, store
from clunk.results.quantities import CELL_QUANTITIES, REGIME_QUANTITIES
from clunk.results.regimemap import Results
from clunk.study.axes import ResultAxis, lash_axis

NAMES = ("gear", "differential")


def made(seed=1, shape=(5, 4), lashes=2):
    """A regime map of several lashes whose numbers are drawn."""
    rng = np.random.default_rng(seed)
    axes = (
        ResultAxis("load.ratio", np.linspace(0.0, 10.0, shape[0]), "load ratio", "σr = Td/Ts", "1"),
        ResultAxis("load.duration", np.linspace(0.0, 1.0, shape[1]), "duration of the load change", "d", "s"),
        lash_axis(NAMES[:lashes]),
    )
    sequence = rng.integers(0, 4, (*shape, lashes)).astype(np.int16)
    impacts = np.array([0, 1, 1, 2], np.int32)[sequence]
    fields = {name: rng.random(sequence.shape) for name in ("severity", "approach_velocity", "margin")}
    fields |= {name: rng.random(impacts.sum()) for name in ("impact_time", "impact_closing_speed", "impact_severity")}
    return Results(
        title="Two lashes",
        axes=axes,
        labels=("NI", "SS(1)", "DS(1)", "DS(1)SS(1)"),
        config='title = "Two lashes"\n',
        config_digest="0" * 64,
        attributes={},
        sequence=sequence,
        primary_impacts=impacts,
        touches=impacts + np.int32(1),
        last_event_time=rng.random(sequence.shape),
        status=np.zeros(sequence.shape, np.uint8),
        quality=np.repeat(rng.integers(0, 4, (*shape, 1)).astype(np.uint8), lashes, axis=-1),
        initial_side=np.ones(sequence.shape, np.int8),
        impact_flank=rng.choice([-1, 1], impacts.sum()).astype(np.int8),
        **fields,
    )


def equal(one, two):
    return all(getattr(one, name).tobytes() == getattr(two, name).tobytes() for name in REGIME_QUANTITIES)


@pytest.fixture(scope="module")
def two():
    return made()


@pytest.fixture
def path(two, tmp_path):
    clunk.write_results(tmp_path / "two.h5", two)
    return tmp_path / "two.h5"


def test_a_file_of_several_lashes_is_read_as_it_was_written(two, path):
    again = clunk.read_results(path)
    assert equal(again, two)
    assert again.lashes == NAMES
    header = store.check(path)
    assert header.lashes == NAMES
    assert header.counts == two.counts()
    assert header.counts_of_lashes == two.counts_of_lashes
    for name, counts in two.counts_of_lashes.items():
        assert counts == {label: n for label, n in two.of_lash(name).counts().items() if n or label == "failed"}


def test_the_dimension_lash_lies_behind_the_axes_and_before_the_impacts(path):
    with h5py.File(path) as file:
        names = [name.decode() for name in file["lash"][()]]
        dimensions = {name: [dim.keys()[0] for dim in file[name].dims] for name in REGIME_QUANTITIES}
    assert names == list(NAMES)
    axes = ["load_ratio", "load_duration"]
    for name, quantity in REGIME_QUANTITIES.items():
        of_lash = [] if name in ("status", "quality") else ["lash"]
        assert dimensions[name] == [*axes, *of_lash, *([quantity.dimension] if quantity.dimension else [])]


def test_xarray_takes_a_lash_by_its_name(two, path):
    pytest.importorskip("h5netcdf")
    dataset = clunk.open_results(path)
    assert dataset.label.dims == ("load_ratio", "load_duration", "lash")
    alone = dataset.sel(lash="differential")
    part = two.of_lash("differential")
    assert (alone.label.values == part.label_map).all()
    np.testing.assert_array_equal(
        alone.impact_time.values,
        np.pad(
            part.padded("impact_time"),
            [(0, 0), (0, 0), (0, two.max_impacts - part.max_impacts)],
            constant_values=np.nan,
        ),
    )


def test_a_file_whose_lash_has_another_name_does_not_match_its_digest(path):
    raw = path.read_bytes()[:-64]  # without its checksum, of which another program would know nothing
    path.write_bytes(raw)
    with h5py.File(path, "r+") as file:
        file["lash"][1] = "axle"
    with pytest.raises(clunk.StoreError, match="damaged"):
        clunk.read_results(path)


@pytest.mark.parametrize("lash", NAMES)
def test_one_lash_is_a_map_without_the_axis(two, lash, tmp_path):
    part, k = two.of_lash(lash), NAMES.index(lash)
    assert part.shape == two.shape[:-1]
    for name in CELL_QUANTITIES:
        np.testing.assert_array_equal(getattr(part, name), getattr(two, name)[..., k])
    for name in ("impact_time", "impact_flank"):
        np.testing.assert_array_equal(part.padded(name)[..., 0], two.padded(name)[..., k, 0])
    clunk.write_results(tmp_path / "one.h5", part)
    assert equal(clunk.read_results(tmp_path / "one.h5"), part)


def test_the_first_lash_is_meant_where_none_is_named(two):
    assert equal(two.of_lash(), two.of_lash("gear"))
    assert equal(two.of_lash("2"), two.of_lash("differential"))
    alone = two.of_lash()
    assert alone.of_lash() is alone


def test_a_lash_of_none_is_refused_with_the_names(two):
    with pytest.raises(clunk.ConfigError, match=r'no lash "rear"; there are gear and differential\.'):
        two.of_lash("rear")
    with pytest.raises(clunk.ConfigError, match=r"there is only lash 1\."):
        two.of_lash().of_lash("rear")
    named = replace(two.of_lash(), config='[lash]\nname = "gear"\n')
    assert named.of_lash("gear") is named


def test_a_slice_keeps_the_lashes(two):
    part = two.at({"load.ratio": 5.0})
    assert part.lashes == NAMES
    assert equal(part.of_lash("differential"), two.of_lash("differential").at({"load.ratio": 5.0}))


def test_exports_have_a_row_for_each_lash_of_each_cell(two, tmp_path):
    export.save(tmp_path / "two.csv", two)
    with (tmp_path / "two.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["lash"] for row in rows] == [*NAMES] * 20
    assert [row["sequence"] for row in rows] == two.label_map.ravel().tolist()
    export.save(tmp_path / "two.mat", two)
    arrays = loadmat(tmp_path / "two.mat", simplify_cells=True)
    assert arrays["lash"].tolist() == list(NAMES)
    np.testing.assert_array_equal(arrays["severity"], two.severity)
