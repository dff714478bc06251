"""Tables of a fit to measurements: the fitted parameters with their priors, and how they are looked for."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from clunk.study.sweeps import Draws
from clunk.study.tables import MOST_DRAWS, Finding, Positive, Table


class Fit(Table):
    """Parameters that are fitted to measurements.

    parameters : with their priors; a factor or an offset of a measured key acts on its measured values
    candidates : int, the most of the search for the best fit
    effective_draws : int, effective size that the ensemble is to have
    draws : int, the most of the ensemble
    seed : int, the same one gives the same fit
    wrong_labels : float, expected share of measured labels that are wrong or that no parameters could meet
    scatter : float, scale of the distance, as a share of the operating point's values, of labels that are not met
    """

    parameters: Draws
    candidates: Annotated[int, Field(ge=1, le=MOST_DRAWS)] = 3000
    effective_draws: Annotated[int, Field(ge=1, le=MOST_DRAWS)] = 400
    draws: Annotated[int, Field(ge=64, le=MOST_DRAWS)] = 8192
    seed: Annotated[int, Field(ge=0)] = 0
    wrong_labels: Annotated[float, Field(gt=0, lt=1)] = 0.1
    scatter: Positive = 0.2

    def contradictions(self) -> Iterator[Finding]:
        """Require that no two entries draw the same number."""
        taken: dict[tuple[str, str], int] = {}
        for k, entry in enumerate(self.parameters):
            first = taken.setdefault((entry.parameter, entry.draws), k)
            if first != k:
                text = f"{entry.parameter} ({entry.draws}) is fitted by fit.parameters[{first + 1}] already"
                yield ("parameters", k, "parameter"), text
