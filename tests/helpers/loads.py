"""Loads of the independent reference: a torque over time in pieces, each a straight line and an exponential."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

GONE = 40.0  # time constants after which a lag has ended: exp(-40) = 4e-18
PARAMETERS = {  # of each profile, as a config names them too
    "ramp": ("duration",),
    "smooth": ("duration",),
    "lag": ("time_constant",),
    "pulse": ("duration",),
    "table": ("times", "torques"),
    "sine": ("amplitude", "frequency"),
}


class Piece(NamedTuple):
    """A stretch of the load: T = constant + slope u + Re(amplitude exp(rate u)) at the time u after `begin`."""

    begin: float
    constant: float
    slope: float = 0.0
    amplitude: complex = 0.0
    rate: complex = 0.0

    def inputs(self, u):
        """(4,): the ramp and its slope, and the real and imaginary part of the exponential."""
        wave = self.amplitude * np.exp(self.rate * u)
        return np.array([self.constant + self.slope * u, self.slope, wave.real, wave.imag])

    def torque(self, u):
        ramp, _, wave, _ = self.inputs(u)
        return ramp + wave


@dataclass(frozen=True)
class Profile:
    """A load profile by its name and the parameters that it uses  [s, N m, Hz].

    `step`, `ramp`, `smooth`, `lag` and `pulse` lead from the plant's torque before the load step to the one after it, a
    `table` from its first torque to its last, and a `sine` swings about the torque after.
    """

    name: str = "step"
    duration: float = 0.0
    time_constant: float = 0.0
    times: tuple = ()
    torques: tuple = ()
    amplitude: float = 0.0
    frequency: float = 0.0

    def pieces(self, before, after):
        """The load from t = 0 on, each piece up to where the next one begins."""
        change, d = after - before, self.duration
        if self.name == "ramp" and d > 0.0:
            return (Piece(0.0, before, change / d), Piece(d, after))
        if self.name == "smooth" and d > 0.0:
            return (Piece(0.0, before + change / 2, 0.0, -change / 2, 1j * np.pi / d), Piece(d, after))
        if self.name == "lag" and self.time_constant > 0.0:
            rate = -1.0 / self.time_constant
            return (Piece(0.0, after, 0.0, -change, rate), Piece(-GONE / rate, after))
        if self.name == "pulse":
            return (Piece(0.0, after), Piece(d, before)) if d > 0.0 else (Piece(0.0, before),)
        if self.name == "table":
            knots = list(zip(self.times, self.torques, strict=True))
            lines = [
                Piece(t, torque, (following - torque) / (until - t))
                for (t, torque), (until, following) in pairwise(knots)
                if until > t
            ]
            return (*lines, Piece(*knots[-1]))
        if self.name == "sine":
            swing = -1j * self.amplitude
            return (Piece(0.0, after, 0.0, swing, 2j * np.pi * self.frequency),)
        return (Piece(0.0, after),)


STEP = Profile()


def step():
    return Profile("step")


def ramp(duration):
    return Profile("ramp", duration=duration)


def smooth(duration):
    return Profile("smooth", duration=duration)


def lag(time_constant):
    return Profile("lag", time_constant=time_constant)


def pulse(duration):
    return Profile("pulse", duration=duration)


def table(times: Sequence[float], torques: Sequence[float]):
    """Straight lines between the torques; two equal times are a jump, of which the second torque holds from then on."""
    if times[0] != 0.0 or list(times) != sorted(times) or max(Counter(times).values()) > 2:
        raise ValueError("the times begin at 0, do not decrease, and no three are equal")
    return Profile("table", times=tuple(map(float, times)), torques=tuple(map(float, torques)))


def sine(amplitude, frequency):
    """The torque after the load step, plus amplitude sin(2π frequency t)."""
    return Profile("sine", amplitude=amplitude, frequency=frequency)


PROFILES = {
    "ramp": ramp(0.1),
    "smooth": smooth(0.15),
    "lag": lag(0.04),
    "pulse": pulse(0.3),
    "table": table((0.0, 0.02, 0.02, 0.08, 0.12, 0.12), (-6.0, -4.0, -2.0, -3.0, -3.0, -1.0)),
    "table that jumps at 0": table((0.0, 0.0, 0.1), (-6.0, -4.0, -1.0)),
    "sine": sine(3.0, 5.0),
}
