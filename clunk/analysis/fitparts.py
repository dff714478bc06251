"""Finished candidates of a fit on their way to its file, in a working directory beside it.

A fit is a sequence of populations, each of which follows from the ones before. So one that was stopped begins again,
and takes up the populations that are on the disk: it gets the very same candidates, and the same result.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from clunk.analysis.fitruns import MATCH, CandidateRuns, Worth
from clunk.results.files import reason, write_whole
from clunk.study.arrays import Floats, Records
from clunk.study.errors import ClunkError
from clunk.sweeping.parts import WorkingDirectory
from clunk.sweeping.progress import Progress
from clunk.sweeping.provenance import versions


class FitError(ClunkError):
    """A fit that cannot start or go on; its text is one sentence for the user."""


class Populations:
    """Populations of candidates, run, or taken up from a working directory.

    runs : CandidateRuns
    identity : of study and measurements
    directory : open; None keeps nothing
    progress, planned : called with the number of candidates so far, and this number in all
    candidates : number of them so far

    Raises FitError where the directory holds a sweep.
    """

    def __init__(
        self,
        runs: CandidateRuns,
        identity: str,
        directory: WorkingDirectory | None = None,
        progress: Progress | None = None,
        planned: int = 0,
    ) -> None:
        self.runs, self.directory, self.progress, self.planned = runs, directory, progress, planned
        self.candidates = self._number = 0
        if directory is not None and (directory.path / "manifest.json").exists():
            raise FitError(
                f"{directory.path} holds an unfinished sweep: finish that one, or begin anew with --restart."
            )
        self._chain = hashlib.sha256(f"{identity} {versions()} {MATCH.descr}".encode()).digest()

    def __call__(self, candidates: Floats, worth: Worth) -> Records:
        """Run the next population; parameters and result as of `CandidateRuns`. Raises FitError."""
        self._number += 1
        self._chain = hashlib.sha256(self._chain + candidates.tobytes()).digest()
        matches = self._kept(len(candidates))
        if matches is None:
            matches = self.runs(candidates, worth)
            self._keep(matches)
        self.candidates += len(candidates)
        if self.progress is not None:
            self.progress(self.candidates, max(self.planned, self.candidates))
        return matches

    def _path(self) -> Path | None:
        return None if self.directory is None else self.directory.path / f"part-{self._number:06}"

    def _kept(self, count: int) -> Records | None:
        """The population as it is on the disk; None where it is not, or another or a damaged one is."""
        path = self._path()
        if path is None or not path.exists():
            return None
        raw = path.read_bytes()
        if raw[:32] != self._chain or raw[32:64] != hashlib.sha256(raw[64:]).digest():
            return None
        return np.frombuffer(raw[64:], MATCH).reshape(count, -1).copy()

    def _keep(self, matches: Records) -> None:
        path = self._path()
        if path is None:
            return
        body = matches.tobytes()
        try:
            write_whole(path, lambda file: file.write(self._chain + hashlib.sha256(body).digest() + body))
        except OSError as error:
            raise FitError(f"{path.parent} cannot take the finished candidates: {reason(error)}.") from error
