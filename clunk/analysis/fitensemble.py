"""Adaptive importance sampling: draws of a posterior, weighted, by populations whose proposals follow the ones before.

Draws are in the coordinates in which the prior is standard normal. Each population is proposed by Gaussian kernels at
draws picked by their weights, and by the prior for a share, so that no region is shut out; all draws then have the
mixture of all proposals as their density (deterministic mixture weights, Owen & Zhou 2000, doi:10.1080/01621459.2000.
10473909; adapted as by Cornuet et al. 2012, doi:10.1111/j.1467-9469.2011.00756.x). While few draws count, the kernels
follow a likelihood that is flattened until enough do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from clunk.study.arrays import Floats

POPULATION = 512
_KERNELS = 64  # of a proposal
_OF_PRIOR = 0.1  # share of a population that the prior proposes
_COUNTING = 0.1  # share of the draws that are to count for the kernels to follow the likelihood as it is
_RIDGE = 1e-6  # least width of a kernel, of the prior's


@dataclass(frozen=True, eq=False)
class Proposal:
    """A mixture of Gaussian kernels and the prior; without kernels the prior alone.

    centres : (k, d)
    root : (d, d) lower triangular, of the kernels' covariance
    """

    centres: Floats
    root: Floats

    def over_prior(self, draws: Floats) -> Floats:
        """Density at some draws, (n, d), as a multiple of the prior's."""
        if not len(self.centres):
            return np.ones(len(draws))
        inverse = np.linalg.inv(self.root)
        whitened = draws @ inverse.T, self.centres @ inverse.T
        squares = ((whitened[0][:, None, :] - whitened[1][None, :, :]) ** 2).sum(axis=2)
        exponents = ((draws**2).sum(axis=1)[:, None] - squares) / 2.0 - np.log(np.diag(self.root)).sum()
        return np.asarray(_OF_PRIOR + (1.0 - _OF_PRIOR) * np.exp(np.minimum(exponents, 600.0)).mean(axis=1))

    def draw(self, count: int, generator: np.random.Generator) -> Floats:
        """Draw from the mixture, (count, d)."""
        normal = generator.standard_normal((count, self.root.shape[0]))
        kernel = generator.integers(len(self.centres), size=count)
        of_prior = generator.random(count) < _OF_PRIOR
        return np.where(of_prior[:, None], normal, self.centres[kernel] + normal @ self.root.T)


@dataclass
class Population:
    """Draws of all populations so far.

    draws : (n, d), in the coordinates of the standard normal prior
    losses : (n,) minus the logarithm of their likelihood
    proposals : of each population
    """

    draws: Floats
    losses: Floats
    proposals: list[Proposal] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)

    @property
    def log_density(self) -> Floats:
        """(n,) logarithm of the density that proposed the draws, as a multiple of the prior's."""
        densities = [
            count * each.over_prior(self.draws) for each, count in zip(self.proposals, self.counts, strict=True)
        ]
        return np.asarray(np.log(np.sum(densities, axis=0) / sum(self.counts)))


def weights_of(losses: Floats, log_density: Floats, flattening: float = 1.0) -> Floats:
    """Weights of draws, which add up to 1; flattening : power of the likelihood."""
    exponents = -flattening * losses - log_density
    weights = np.exp(exponents - exponents.max())
    return np.asarray(weights / weights.sum())


def effective_size(weights: Floats) -> float:
    """Number of equally weighted draws that would be as good."""
    return float(1.0 / (weights**2).sum())


def sample(loss_of: Callable[[Floats], Floats], dimensions: int, effective: float, most: int, seed: int) -> Population:
    """Draw populations until they are worth `effective` draws, or are `most`.

    Parameters
    ----------
    loss_of : of draws, (n, dimensions), minus the logarithm of their likelihood, (n,)
    """
    from scipy.stats import norm

    first = sobol_points(min(POPULATION, most), dimensions, np.random.default_rng([seed, 0]))
    draws = np.asarray(norm.ppf(np.clip(first, 1e-12, 1.0 - 1e-12)), np.float64)
    population = Population(draws, loss_of(draws), [Proposal(draws[:0], np.eye(dimensions))], [len(draws)])
    while len(population.draws) < most:
        density = population.log_density
        if effective_size(weights_of(population.losses, density)) >= effective:
            break
        generator = np.random.default_rng([seed, len(population.counts)])
        proposal = proposal_after(population, density, generator)
        draws = proposal.draw(min(POPULATION, most - len(population.draws)), generator)
        population.losses = np.concatenate([population.losses, loss_of(draws)])
        population.draws = np.concatenate([population.draws, draws])
        population.proposals.append(proposal)
        population.counts.append(len(draws))
    return population


def sobol_points(count: int, dimensions: int, generator: np.random.Generator) -> Floats:
    """The first points, (count, dimensions), of a scrambled Sobol sequence."""
    from scipy.stats import qmc

    return np.asarray(qmc.Sobol(dimensions, seed=generator).random_base2((count - 1).bit_length())[:count])


def proposal_after(population: Population, log_density: Floats, generator: np.random.Generator) -> Proposal:
    """The kernels that follow the weights of the draws so far, flattened until enough draws count."""
    enough, losses = _COUNTING * POPULATION, population.losses
    low, high = 0.0, 1.0
    weights = weights_of(losses, log_density)
    if effective_size(weights) < enough:
        for _ in range(40):
            middle = (low + high) / 2.0
            if effective_size(weights_of(losses, log_density, middle)) < enough:
                high = middle
            else:
                low = middle
        weights = weights_of(losses, log_density, low)
    dimensions = population.draws.shape[1]
    offsets = population.draws - weights @ population.draws
    covariance = (offsets * weights[:, None]).T @ offsets
    width = (4.0 / ((dimensions + 2) * effective_size(weights))) ** (1.0 / (dimensions + 4))  # Silverman's rule
    root = np.linalg.cholesky(width**2 * covariance + _RIDGE**2 * np.eye(dimensions))
    picked = generator.choice(len(weights), size=_KERNELS, p=weights)
    return Proposal(population.draws[picked], root)
