"""The working directory for finished cells beside the results file that they are for: NAME.h5.partial.

    lock             held by the one process that writes; released when that process ends
    manifest.json    the study with its sweep, its digest and the versions
    part-000001      the cells that finished in the first seconds; and so on

A part is complete before it gets its name, and is checked when it is read. The results file is assembled once, beside
the parts, and moved into its place; then the directory is removed.
"""

import hashlib
import io
import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import BinaryIO, Self

import numpy as np

from clunk.results.files import reason, write_whole
from clunk.study.config import study_from_text
from clunk.study.document import FilePath, leaves
from clunk.study.errors import ClunkError, ConfigError, shorten
from clunk.study.study import Study, decisive_content, digest, to_toml
from clunk.sweeping.cells import Tile
from clunk.sweeping.engines import deferred_signals
from clunk.sweeping.machine import versions

_DIGEST = 32  # bytes of SHA-256
_PART = 2.0  # s between parts, at least: a shorter sweep is soon run again; 20,000 cells are 3 MB and take 25 ms
_LONGEST_PART = 30.0  # s between parts, at most
_LARGEST_PART = 1 << 20  # cells, about 120 MB, at which a part is written at once: many workers finish them sooner
_SHARE = 0.02  # of the time so far, which may pass between parts and be lost: a day's sweep is then not 50,000 files


class PartsError(ClunkError):
    """Finished cells that cannot be kept on the disk or read back; its text is one sentence for the user."""


class WorkingDirectory:
    """The working directory of one results file, locked while this context is open.

    target : the results file; where that is a symbolic link, the file that it points to
    """

    def __init__(self, target: FilePath) -> None:
        self.target = Path(os.path.realpath(target))
        self.path = self.target.with_name(self.target.name + ".partial")
        self._lock: BinaryIO | None = None

    def __enter__(self) -> Self:
        """Take the lock. Raises PartsError where another process has it."""
        try:
            while self._lock is None:
                self.path.mkdir(exist_ok=True)
                with suppress(FileNotFoundError):  # removed in between by the process that has just finished
                    self._lock = self._locked()
        except OSError as error:
            raise PartsError(f"{self.path} cannot be used: {reason(error)}.") from error
        return self

    def __exit__(self, *_error: object) -> None:
        """Release the lock; the directory stays if there are parts in it."""
        if not self.parts():
            self.remove()
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def parts(self) -> list[Path]:
        """The parts, in the order in which they were written."""
        return sorted(self.path.glob("part-" + 6 * "[0-9]"))

    def clear(self) -> None:
        """Remove the parts, the manifest and unfinished files; files that others have put there stay."""
        try:
            for path in [*self.parts(), *self.path.glob(".*.tmp"), self.path / "manifest.json"]:
                path.unlink(missing_ok=True)
        except OSError as error:
            raise PartsError(f"{self.path} cannot be emptied: {reason(error)}.") from error

    def remove(self) -> None:
        """Remove the directory, unless others have put files there."""
        with suppress(OSError, PartsError):
            self.clear()
            if os.name == "nt" and self._lock is not None:
                self._lock.close()  # Windows removes no open file
            (self.path / "lock").unlink(missing_ok=True)
            self.path.rmdir()

    def _locked(self) -> BinaryIO | None:
        """The lock, or None where its file was removed before it was locked."""
        path = self.path / "lock"
        with ExitStack() as closing:
            lock = closing.enter_context(path.open("ab"))
            try:
                _lock(lock)
            except BlockingIOError:
                raise PartsError(f"{self.target} is being written by another sweep that still runs.") from None
            if os.name == "nt" or os.path.samestat(os.fstat(lock.fileno()), path.stat()):
                closing.pop_all()
                return lock
        return None


class Parts:
    """The finished cells of one sweep in a working directory.

    directory : the working directory, open and thus locked
    study : Study

    Raises PartsError where the directory holds parts of another study.
    """

    def __init__(self, directory: WorkingDirectory, study: Study) -> None:
        self.directory = directory
        self.discarded = 0  # parts of other versions, or damaged
        self.taken_up = 0  # cells that have been read
        self.kept = 0  # cells that are on the disk
        decisive = {"config_digest": digest(study), "versions": versions()}
        self._origin = json.dumps(decisive).encode()
        self._manifest = {**decisive, "config": to_toml(study)}  # the config names the keys that differ
        self._waiting: list[Tile] = []
        self._cells_waiting = 0
        self._number = max((int(path.name.removeprefix("part-")) for path in directory.parts()), default=0)
        self._began = self._written = time.monotonic()
        self._refuse_other_sweeps(study)

    def read(self) -> Iterator[Tile]:
        """Yield the tiles of all parts that are undamaged and of this sweep; remove all other parts."""
        for path in self.directory.parts():
            try:
                tiles = tiles_of(_bytes_of(path), self._origin)
            except ValueError:
                self.discarded += 1
                with suppress(OSError):
                    path.unlink()
                continue
            self.taken_up += sum(tile.cells.size for tile in tiles)
            self.kept = self.taken_up
            yield from tiles

    def add(self, tile: Tile) -> None:
        """Keep a tile; when it is time for a part, write all tiles since the last one. Raises PartsError as `flush`."""
        self._waiting.append(tile)
        self._cells_waiting += tile.cells.size
        now = time.monotonic()
        pause = min(max(_PART, _SHARE * (now - self._began)), _LONGEST_PART)
        if now - self._written >= pause or self._cells_waiting >= _LARGEST_PART:
            self.flush()

    def flush(self) -> None:
        """Write the tiles that have accumulated as a part. Raises PartsError where they cannot be written."""
        if not self._waiting:
            return
        with deferred_signals():  # so that a part that has been written is also counted as such
            try:
                manifest = self.directory.path / "manifest.json"
                if not manifest.exists():
                    text = json.dumps(self._manifest, indent=1, ensure_ascii=False)
                    write_whole(manifest, lambda file: file.write(text.encode()))
                part = self.directory.path / f"part-{self._number + 1:06}"
                write_whole(part, lambda file: write_tiles(file, self._waiting, self._origin))
            except OSError as error:
                raise PartsError(
                    f"{self.directory.path} cannot take the finished cells: {reason(error)}; "
                    "the same command goes on from what is there."
                ) from error
            self._number += 1
            self.kept += self._cells_waiting
            self._cells_waiting = 0
            self._waiting.clear()
            self._written = time.monotonic()

    def _refuse_other_sweeps(self, study: Study) -> None:
        """Raise PartsError where the directory's manifest is of another config.

        A damaged manifest is removed: the checksum of each part identifies its sweep, too.
        """
        path = self.directory.path / "manifest.json"
        if not path.exists():
            return
        try:
            earlier = json.loads(_bytes_of(path))
            is_other = earlier["config_digest"] != self._manifest["config_digest"]
            differing = differences(earlier["config"], study)
        except (ValueError, LookupError, TypeError, AttributeError):
            path.unlink()
            return
        if is_other:
            raise PartsError(
                f"{self.directory.path} holds an unfinished sweep of another config ({differing}): finish that one, or "
                "begin anew with --restart (in Python, restart=True)."
            )


def _bytes_of(path: Path) -> bytes:
    """Content of a file of the working directory.

    Raises PartsError where it cannot be read: as it may be readable later, it does not count as damaged.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise PartsError(f"{path} cannot be read: {reason(error)}.") from error


def write_tiles(file: BinaryIO, tiles: Sequence[Tile], origin: bytes) -> None:
    """Write a SHA-256 checksum, then each tile's cells, records and details, each in NumPy's .npy format.

    origin : identifies the study and the versions of the tiles; only the checksum depends on it
    """
    content = io.BytesIO()
    for tile in tiles:
        for array in tile:
            np.save(content, array)
    file.write(hashlib.sha256(origin + content.getbuffer()).digest())
    file.write(content.getbuffer())


def tiles_of(raw: bytes, origin: bytes) -> list[Tile]:
    """Tiles from bytes that `write_tiles` wrote. Raises ValueError where a bit or the origin differs."""
    checksum, content, tiles = raw[:_DIGEST], raw[_DIGEST:], []
    if hashlib.sha256(origin + content).digest() != checksum:
        raise ValueError("damaged, or of another study or version")
    arrays = io.BytesIO(content)
    while arrays.tell() < len(content):
        tiles.append(Tile(*(np.load(arrays) for _ in Tile._fields)))
    return tiles


def differences(config: str, study: Study) -> str:
    """The first five keys in which a config differs from a study, with both values, and how many more there are."""
    try:
        earlier, current = (
            dict(leaves(decisive_content(each), whole_lists=True)) for each in (study_from_text(config), study)
        )
    except ConfigError:
        return "which this version refuses"
    keys = [key for key in earlier | current if earlier.get(key) != current.get(key)]
    texts = [f"{key} = {_shown(earlier.get(key))} there, {_shown(current.get(key))} here" for key in keys[:5]]
    return "; ".join([*texts, f"and {len(keys) - 5} more"] if len(keys) > 5 else texts)


def _shown(value: object) -> str:
    return "nothing" if value is None else shorten(value)


def _lock(file: BinaryIO) -> None:
    """Lock a file until it is closed or the process ends. Raises BlockingIOError where another process has done so."""
    if sys.platform == "win32":
        import msvcrt

        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError as error:
            raise BlockingIOError from error
    else:
        import fcntl

        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
