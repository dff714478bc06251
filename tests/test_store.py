"""The results file: what is written is what is read, by clunk and by others, and a bad file is a sentence."""

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray
from helpers.maps import CELL_QUANTITIES, IMPACT_QUANTITIES, with_arrays

from clunk.core.status import Status
from clunk.results import netcdf, store
from clunk.results.files import reason
from clunk.results.maps import Results
from clunk.study.axes import ResultAxis
from clunk.study.errors import ClunkError

ROOT = Path(__file__).parents[1]
RATIO = ResultAxis("load.ratio", np.linspace(0.0, 10.0, 5), "load ratio", "σr = Td/Ts", "1")
BACKLASH = ResultAxis("lash.backlash_deg", np.geomspace(0.5, 20.0, 4), "backlash", "φθ", "degrees")
INERTIA = ResultAxis("driveline.inertias[4]", np.array([0.001, 0.002, 0.005]), "inertia 4", "J4", "kg m2")
LABELS = ("NI", "SS(1)", "DS(1)SS(1)", "DS(2)SS(1)")
PRIMARIES = np.array([0, 1, 3, 5])


def example(*axes: ResultAxis, impacts: bool = True) -> Results:
    """Results with every label and one failed cell; random numbers that a mix-up of cells would show."""
    rng = np.random.default_rng(7)
    shape = tuple(len(axis.values) for axis in axes)
    cells = int(np.prod(shape))
    sequence = (np.arange(cells) % len(LABELS) if impacts else np.zeros(cells)).astype(np.int16).reshape(shape)
    primaries = PRIMARIES[sequence].astype(np.int32)
    status = np.zeros(shape, np.uint8)
    failed = np.unravel_index(cells // 2, shape)
    sequence[failed], primaries[failed], status[failed] = -1, 0, Status.NON_FINITE
    severity = rng.uniform(0.0, 2e4, shape)
    severity[failed] = np.nan
    count = int(primaries.sum())
    return Results(
        title="Régimes",
        axes=axes,
        labels=LABELS if impacts else LABELS[:1],
        config='title = "Régimes"\n' + "# a long resolved config\n" * 5000,
        config_digest="ab" * 32,
        attributes={"clunk_version": "0.1.0", "created": "2026-01-02T03:04:05+00:00", "cpu": "Ω 5000"},
        arrays={
            "sequence": sequence,
            "severity": severity,
            "approach_velocity": rng.uniform(0.0, 20.0, shape),
            "last_event_time": np.where(primaries > 0, rng.uniform(0.0, 1.0, shape), np.nan),
            "primary_impacts": primaries,
            "touches": (7 * primaries).astype(np.int32),
            "status": status,
            "quality": rng.integers(0, 16, shape, np.uint8),
            "initial_side": rng.integers(-1, 2, shape, np.int8),
            "margin": np.where(status, np.nan, rng.uniform(-0.25, 0.25, shape)),
            "impact_time": rng.uniform(0.0, 1.0, count),
            "impact_flank": rng.choice(np.array([-1, 1], np.int8), count),
            "impact_closing_speed": rng.uniform(0.0, 20.0, count),
            "impact_severity": rng.uniform(0.0, 1e4, count),
        },
    )


def padded(results: Results, name: str) -> np.ndarray:
    """Array of a quantity as its file has it: behind a cell's last impact NaN or 0."""
    return store.dataset_of(results).padded(name)


def assert_same(left: Results, right: Results) -> None:
    for name in (*CELL_QUANTITIES, *IMPACT_QUANTITIES):
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name), strict=True, err_msg=name)
    for name in ("title", "labels", "config", "config_digest", "attributes"):
        assert getattr(left, name) == getattr(right, name)
    for one, other in zip(left.axes, right.axes, strict=True):
        np.testing.assert_array_equal(one.values, other.values, strict=True)
        for name in ("parameter", "name", "symbol", "unit"):
            assert getattr(one, name) == getattr(other, name)


AXES = [(RATIO,), (RATIO, BACKLASH), (INERTIA, RATIO, BACKLASH)]


@pytest.mark.parametrize("impacts", [True, False], ids=["impacts", "no impacts"])
@pytest.mark.parametrize("axes", AXES, ids=["one axis", "two axes", "three axes"])
def test_what_is_written_is_what_is_read(tmp_path: Path, axes: tuple[ResultAxis, ...], impacts: bool) -> None:
    """Without any impact there is a dimension of one all the same."""
    results = example(*axes, impacts=impacts)
    store.write_results(tmp_path / "map.h5", results)
    assert_same(results, store.read_results(tmp_path / "map.h5"))
    with h5py.File(tmp_path / "map.h5") as file:
        assert file["impact"].size == (5 if impacts else 1)
        assert impacts or np.isnan(file["impact_time"][()]).all()


@pytest.mark.parametrize(("places", "together"), [(1, 1), (250, 1), (1, 30), (250, 90)])
def test_a_file_is_the_same_in_however_many_parts_its_impacts_are_written_and_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, places: int, together: int
) -> None:
    """By row, or by two: the values of a map with one busy cell need never be in memory with their padding.

    A chunk has one place of each cell, or two or three of five, so that the last one reaches beyond them.
    """
    results = example(INERTIA, RATIO, BACKLASH)
    store.write_results(tmp_path / "whole.h5", results)
    monkeypatch.setattr(netcdf, "_SLAB", places)
    monkeypatch.setattr(netcdf, "_CHUNK", together)
    monkeypatch.setattr(netcdf, "_SMALL", 0)
    store.write_results(tmp_path / "parts.h5", results)
    for name in ("whole.h5", "parts.h5"):
        assert_same(results, store.read_results(tmp_path / name))
    with h5py.File(tmp_path / "whole.h5") as whole, h5py.File(tmp_path / "parts.h5") as parts:  # as HDF5 itself reads
        for name, stored in parts.items():
            np.testing.assert_array_equal(stored[()], whole[name][()])
        impacts = parts["impact_time"]
        assert (impacts.compression, impacts.compression_opts, impacts.shuffle) == ("gzip", 1, True)
        assert impacts.chunks[:2] < impacts.shape[:2]
        assert impacts.chunks[-1] == {1: 1, 30: 2, 90: 3}[together]


def test_padded_impacts_follow_their_cell() -> None:
    results = example(RATIO, BACKLASH)
    speeds, flanks = padded(results, "impact_closing_speed"), padded(results, "impact_flank")
    assert speeds.shape == flanks.shape == (5, 4, 5)
    position = 0
    for cell in np.ndindex(results.shape):
        count = results.primary_impacts[cell]
        np.testing.assert_array_equal(
            speeds[cell][:count], results.impact_closing_speed[position : position + count], strict=True
        )
        assert np.isnan(speeds[cell][count:]).all()
        assert not flanks[cell][count:].any()
        position += count
    assert position == results.impact_time.size


# --- for other people's readers


@pytest.mark.parametrize("axes", AXES, ids=["one axis", "two axes", "three axes"])
def test_xarray_sees_named_dimensions_and_coordinates(tmp_path: Path, axes: tuple[ResultAxis, ...]) -> None:
    results = example(*axes)
    store.write_results(tmp_path / "map.h5", results)
    names = [axis.variable for axis in axes]
    with xarray.open_dataset(tmp_path / "map.h5", engine="h5netcdf") as dataset:
        assert list(dataset["severity"].dims) == names
        assert list(dataset["impact_time"].dims) == [*names, "impact"]
        np.testing.assert_array_equal(dataset["impact"], np.arange(1, 6))
        for axis in axes:
            np.testing.assert_array_equal(dataset.coords[axis.variable], axis.values)
            assert dataset[axis.variable].attrs["units"] == axis.unit
            assert dataset[axis.variable].attrs["parameter"] == axis.parameter
        assert set(dataset.data_vars) == {*CELL_QUANTITIES, *IMPACT_QUANTITIES}
        for name, variable in dataset.variables.items():
            assert variable.attrs["units"], name
            assert variable.attrs["long_name"], name
        np.testing.assert_array_equal(dataset["impact_severity"], padded(results, "impact_severity"))
        assert dataset["last_event_time"].dtype == np.float64  # "s" is not decoded into a time delta
        assert dataset.attrs["Conventions"] == "CF-1.11"
        assert dataset.attrs["schema_version"] == netcdf.SCHEMA_VERSION
        assert dataset.attrs["title"] == "Régimes"
        assert dataset.attrs["config"] == results.config
        assert dataset.attrs["cpu"] == "Ω 5000"


def test_flag_meanings_decode_every_code(tmp_path: Path) -> None:
    results = example(RATIO, BACKLASH)
    store.write_results(tmp_path / "map.h5", results)
    with xarray.open_dataset(tmp_path / "map.h5", engine="h5netcdf") as dataset:
        sequence = dataset["sequence"]
        assert sequence.dtype == np.int16
        assert "_FillValue" not in sequence.attrs | sequence.encoding
        meaning = dict(zip(sequence.attrs["flag_values"], sequence.attrs["flag_meanings"].split(), strict=True))
        assert meaning == {0: "NI", 1: "SS(1)", 2: "DS(1)SS(1)", 3: "DS(2)SS(1)", -1: "failed"}
        status = dataset["status"].attrs
        assert dict(zip(status["flag_values"], status["flag_meanings"].split(), strict=True))[3] == "non_finite"
        quality = dataset["quality"].attrs
        assert dict(zip(quality["flag_masks"], quality["flag_meanings"].split(), strict=True)) == {
            1: "complete",
            2: "undecided",
            8: "grazing",
        }


def test_the_file_needs_no_hdf5_types_that_netcdf_lacks(tmp_path: Path) -> None:
    store.write_results(tmp_path / "map.h5", example(RATIO, BACKLASH))
    with h5py.File(tmp_path / "map.h5") as file:
        for name, variable in file.items():
            assert variable.dtype.kind in "iuf", name
        assert isinstance(file["severity"].attrs.get_id("units").dtype, np.dtypes.BytesDType)
        assert h5py.check_string_dtype(file.attrs.get_id("config").dtype).length is None


def test_content_digest_depends_on_the_data_and_nothing_else(tmp_path: Path) -> None:
    def digest(results: Results) -> str:
        store.write_results(tmp_path / "map.h5", results)
        with h5py.File(tmp_path / "map.h5") as file:
            return file.attrs["content_digest"]

    results = example(RATIO, BACKLASH)
    original = digest(results)
    assert digest(replace(results, title="other", attributes={"created": "later"})) == original
    severity = results.severity.copy()
    severity[0, 0] = np.nextafter(severity[0, 0], np.inf)
    time = results.impact_time.copy()
    time[-1] = np.nextafter(time[-1], np.inf)
    moved = replace(BACKLASH, values=BACKLASH.values + 1.0)
    others = [
        digest(with_arrays(results, severity=severity)),
        digest(with_arrays(results, impact_time=time)),
        digest(replace(results, axes=(RATIO, moved))),
        digest(replace(results, labels=("NI", "SS(2)", *LABELS[2:]))),
    ]
    assert len({original, *others}) == 5


# --- interrupted and impossible writes


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()], ids=["full", "ctrl-c"])
@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_an_interrupted_write_leaves_the_old_file_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException, call: str
) -> None:
    old = example(RATIO, BACKLASH)
    store.write_results(tmp_path / "map.h5", old)

    def fail(*_: object) -> None:
        assert len(list(tmp_path.iterdir())) == 2  # the temporary file is beside the old one by now
        raise error

    if call == "fsync":
        monkeypatch.setattr(os, "fsync", fail)
    else:
        monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(ClunkError if isinstance(error, OSError) else KeyboardInterrupt) as raised:
        store.write_results(tmp_path / "map.h5", replace(old, title="new"))
    monkeypatch.undo()
    if isinstance(error, OSError):
        assert_sentence(raised.value, tmp_path / "map.h5", "no space left on device")
    assert [path.name for path in tmp_path.iterdir()] == ["map.h5"]
    assert_same(old, store.read_results(tmp_path / "map.h5"))


def test_a_full_disk_is_a_sentence_and_the_interpreter_ends_well(tmp_path: Path) -> None:
    # In a process of its own: what went wrong with HDF5's own writing was the crash when the interpreter exits.
    code = f"""
import resource, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from test_store import BACKLASH, RATIO, ClunkError, example, netcdf, store
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
try:
    store.write_results({str(tmp_path / "map.h5")!r}, example(RATIO, BACKLASH))
except ClunkError as error:
    print(error)
"""
    pytest.importorskip("resource")
    answer = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (answer.returncode, answer.stderr) == (0, "")
    assert answer.stdout.strip().endswith("cannot be written: file too large.")
    assert list(tmp_path.iterdir()) == []


def test_writing_through_a_link_replaces_what_it_points_to(tmp_path: Path) -> None:
    store.write_results(tmp_path / "map.h5", example(RATIO))
    (tmp_path / "link.h5").symlink_to(tmp_path / "map.h5")
    store.write_results(tmp_path / "link.h5", example(RATIO, BACKLASH))
    assert (tmp_path / "link.h5").is_symlink()
    assert store.read_results(tmp_path / "map.h5").shape == (5, 4)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes are POSIX")
def test_a_pipe_or_a_device_stays_what_it_is(tmp_path: Path) -> None:
    """A file that is renamed to its name would take its place: a reader would wait for ever."""
    os.mkfifo(tmp_path / "pipe.h5")
    with pytest.raises(ClunkError, match=r"pipe.h5 is a device or a pipe; name a file\."):
        store.write_results(tmp_path / "pipe.h5", example(RATIO))
    assert (tmp_path / "pipe.h5").is_fifo()
    (tmp_path / "zero.h5").symlink_to("/dev/zero")  # whose bytes never end
    with pytest.raises(netcdf.StoreError) as raised:
        store.read_results(tmp_path / "zero.h5")
    assert_sentence(raised.value, tmp_path / "zero.h5", "is a device")
    with pytest.raises(ClunkError, match="is a device or a pipe"):
        store.write_results(tmp_path / "zero.h5", example(RATIO))
    assert (tmp_path / "zero.h5").is_char_device()


@pytest.mark.skipif(os.name != "posix", reason="symbolic links need no rights on POSIX")
def test_a_link_that_leads_to_itself_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "map.h5").symlink_to("map.h5")
    store.write_results(tmp_path / "map.h5", example(RATIO))
    assert store.read_results(tmp_path / "map.h5").shape == (5,)


def test_writing_onto_a_directory_or_under_a_file_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    with pytest.raises(ClunkError) as raised:
        store.write_results(tmp_path / "taken", example(RATIO))
    assert_sentence(raised.value, tmp_path / "taken", "is a directory")
    (tmp_path / "file").touch()
    with pytest.raises(ClunkError) as raised:
        store.write_results(tmp_path / "file" / "map.h5", example(RATIO))
    assert_sentence(raised.value, tmp_path / "file" / "map.h5", "cannot be written")
    with pytest.raises(ClunkError, match=r"must end in \.h5"):  # else HDF5 would stand under the name of a table
        store.write_results(tmp_path / "map.csv", example(RATIO))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "taken"]


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(28, "No space left on device"), "no space left on device"),
        (ValueError("Two\n  lines."), "two lines"),
        (MemoryError(), "MemoryError"),
    ],
)
def test_a_reason_can_stand_within_a_sentence(error: Exception, words: str) -> None:
    assert reason(error).lower() == words.lower()


# --- files that are not what they should be


def assert_sentence(error: ClunkError, path: Path, part: str) -> None:
    text = str(error)
    assert text.startswith(str(path))
    assert part in text
    assert text.endswith(".")
    assert "\n" not in text
    assert ". " not in text


def changed(change: Callable[[h5py.File], object], *, checksum: bool = False) -> Callable[[Path], None]:
    """What changes a file by its open HDF5; with `checksum` as a program that knows of that."""

    def edit(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            change(file)
        if checksum:
            raw = path.read_bytes()
            path.write_bytes(raw + b"clunk-sha256:" + hashlib.sha256(raw).hexdigest().encode() + b"\n")

    return edit


def flip(place: int) -> Callable[[Path], None]:
    def edit(path: Path) -> None:
        raw = bytearray(path.read_bytes())
        raw[place] ^= 1
        path.write_bytes(raw)

    return edit


def cut(length: int) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(path.read_bytes()[:length])


BROKEN = {
    "missing": (lambda path: path.unlink(), "no such file or directory"),
    "directory": (lambda path: (path.unlink(), path.mkdir()), "is a directory"),
    "empty": (lambda path: path.write_bytes(b""), "not HDF5"),
    "text": (lambda path: path.write_text("σr, φθ\n"), "not HDF5"),
    "other schema": (
        changed(lambda file: file.attrs.__setitem__("schema_version", np.int32(7)), checksum=True),
        "has schema version 7, and this clunk reads",
    ),
    "without a variable": (
        changed(lambda file: file.__delitem__("margin"), checksum=True),
        "lacks what this clunk reads",
    ),
    "without its schema": (
        changed(lambda file: file.attrs.__delitem__("schema_version"), checksum=True),
        "lacks what this clunk reads (schema_version)",
    ),
    "foreign": (changed(lambda file: file.clear()), "another program has made or changed it"),
    "changed": (changed(lambda file: file["severity"].__setitem__((1, 1), -1.0)), "has made or changed it"),
    "truncated": (cut(4000), "it was cut"),
    "without its checksum": (cut(-78), "it was cut"),
    "without its last byte": (cut(-1), "it was cut"),
    "longer": (lambda path: path.write_bytes(path.read_bytes() + b"\n"), "is not a whole results file"),
    "a bit of the data": (flip(3000), "do not match their checksum"),
    "a bit of the checksum": (flip(-40), "do not match their checksum"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_file_is_one_sentence(tmp_path: Path, what: str) -> None:
    path = tmp_path / "map.h5"
    store.write_results(path, example(RATIO, BACKLASH))
    damage, part = BROKEN[what]
    damage(path)
    with pytest.raises(netcdf.StoreError) as raised:
        store.read_results(path)
    assert_sentence(raised.value, path, part)


# --- the bytes' own checksum


def test_hdf5_and_netcdf_readers_do_not_mind_the_checksum(tmp_path: Path) -> None:
    path = tmp_path / "map.h5"
    store.write_results(path, example(RATIO, BACKLASH))
    raw = path.read_bytes()
    assert raw[-78:] == b"clunk-sha256:" + hashlib.sha256(raw[:-78]).hexdigest().encode() + b"\n"
    with h5py.File(path) as file:
        assert file["severity"].shape == (5, 4)
    with xarray.open_dataset(path, engine="h5netcdf") as dataset:
        assert dataset["severity"].shape == (5, 4)


BARRAGE = f"""
import faulthandler, random, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from test_store import BACKLASH, RATIO, Path, example, netcdf, store
path = Path(sys.argv[1])
store.write_results(path, example(RATIO, BACKLASH))
raw = path.read_bytes()
chance = random.Random(5)
for k in range(2 * int(sys.argv[2])):
    if k % 2:
        changed = bytearray(raw)
        changed[chance.randrange(len(raw))] ^= 1 << chance.randrange(8)
    else:
        changed = raw[: chance.randrange(len(raw))]
    path.write_bytes(changed)
    faulthandler.dump_traceback_later(10, exit=True)
    for reader in (store.read_results, netcdf.read):
        try:
            reader(path)
        except netcdf.StoreError as error:
            assert str(error).startswith(str(path))
        else:
            print("believed", k)
    faulthandler.cancel_dump_traceback_later()
"""


def test_three_hundred_cuts_and_three_hundred_flipped_bits_are_all_refused_at_once(tmp_path: Path) -> None:
    # In a process of its own, which a hang or a crash of HDF5 would end.
    command = [sys.executable, "-c", BARRAGE, str(tmp_path / "map.h5"), "300"]
    answer = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (answer.returncode, answer.stdout, answer.stderr) == (0, "", "")
