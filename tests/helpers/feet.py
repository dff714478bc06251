"""Load ratios at which the labels of the report's driveline change for vanishing backlash, by linear theory."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from helpers.plant import Plant


def feet_of_figure_3_4():
    """Ascending load ratios σr at which the overlap 1 + σr g of the closed lash changes sign once more."""
    extremes = closed_overlap(np.linspace(1e-6, 2.0, 40001))
    records = [share for k, share in enumerate(extremes) if share < 0.0 and share == extremes[k:].min()]
    return -1.0 / np.array(records)


def closed_overlap(times):
    """Torque in the report's lash after a unit load step from the torque 1 to 0, contact closed, as a share of 1.

    Without backlash, both flanks are one spring and damper, and the chain is linear: θ'' = -J⁻¹ (C θ' + K θ).
    """
    plant = Plant()
    across = np.outer(plant.twist, plant.twist)
    damping, stiffness = plant.open_matrices()
    damping, stiffness = damping + plant.contact_damping * across, stiffness + plant.contact_stiffness * across
    inertias = np.array(plant.inertias)[:, None]
    flow = np.block([[np.zeros((4, 4)), np.eye(4)], [-stiffness / inertias, -damping / inertias]])
    rest = np.linalg.solve(stiffness, [1.0, 0.0, 0.0, 0.0])
    gap = np.array([0, 0, 1.0, -1.0, 0, 0, 0, 0])
    start = np.concatenate([rest, np.zeros(4)])
    values, vectors = np.linalg.eig(flow)
    left = np.linalg.solve(vectors, start)
    assert vectors @ (np.exp(values * 0.1) * left) == pytest.approx(expm(flow * 0.1) @ start, abs=1e-12)
    slopes = lambda t: float((gap @ vectors @ (values * np.exp(values * t) * left)).real)  # noqa: E731
    shares = lambda t: float((gap @ vectors @ (np.exp(values * t) * left)).real / (gap @ start))  # noqa: E731
    extremes = [brentq(slopes, a, b, xtol=1e-14) for a, b in pairwise(times) if slopes(a) * slopes(b) < 0.0]
    return np.array([shares(t) for t in extremes])
