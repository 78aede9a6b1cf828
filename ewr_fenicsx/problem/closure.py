"""What stands for the harmonics left out of a truncated friction force: springs where surroundings bend, or masses.

Beyond the highest harmonic a contact node moves against its elastic neighbourhood, or as a mass by itself. Its own
dynamic flexibility there tells which, and how soft the springs are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.model.compliance import find_normal_modes, receptance
from ewr_fenicsx.model.reduced_model import ReducedModel

Closure = Literal["mass", "dashpot", "spring"]
ALIKE, ALONE = 2.0, 0.05  # of a mass: ratio by which it may vary over the harmonics left out; share that others move it
LEAST_ELASTIC = 0.15  # share of a pair's static flexibility, beyond the harmonics kept, above which it is a spring


def find_springs(model: ReducedModel, rows: RealArray, flexibility: RealArray, omega: float, highest: int) -> RealArray:
    """``(m,)`` flexibility of contact rows beyond a highest harmonic, zero of those that move as masses [m/N].

    Args:
        model: The reduced model.
        rows: ``(m, n)`` contact rows.
        flexibility: ``(m,)`` static flexibility of each by itself [m/N].
        omega: Angular frequency of the first harmonic [rad/s].
        highest: Highest harmonic that is kept.
    """
    try:
        beyond = average(np.abs(measure_beyond(model, rows, omega, list_beyond(highest))))
    except ModelError:  # one hits an undamped mode exactly
        return np.zeros(len(rows))
    return np.where(beyond > LEAST_ELASTIC * flexibility, beyond, 0.0)


def find_masses(model: ReducedModel, rows: RealArray, omega: float, highest: int) -> RealArray:
    """``(m,)`` mass of contact rows that move beyond a highest harmonic as masses by themselves, zero of others [kg].

    Not of those that damping holds there more than inertia does.

    Args:
        model: The reduced model.
        rows: ``(m, n)`` rows along which pairs rub, all of them: they may not move each other.
        omega: Angular frequency of the first harmonic [rad/s].
        highest: Highest harmonic that is kept.
    """
    found, beyond = np.zeros(len(rows)), np.array(list_beyond(highest))
    try:
        if np.all(measure_beyond(model, rows, omega, beyond[:1]).real >= 0):  # mostly: one harmonic tells
            return found
        own, rates = measure_beyond(model, rows, omega, beyond), beyond * omega
    except ModelError:  # one hits an undamped mode exactly
        return found
    inertia = -1 / (own * rates[:, None] ** 2)
    mass, damped = inertia.real, np.abs(inertia.imag)
    alike = (mass.min(axis=0) > 0) & (mass.max(axis=0) < ALIKE * mass.min(axis=0))
    alike = np.flatnonzero(alike & np.all(damped < mass, axis=0))
    if alike.size:
        moved = np.array([receptance(model, rate, rows, rows[alike].T) for rate in rates])
        others = np.abs(moved).sum(axis=1) - np.abs(own[:, alike])
        alone = alike[np.all(others < ALONE * np.abs(own[:, alike]), axis=0)]
        found[alone] = mass[:, alone].mean(axis=0)
    return found


def measure_beyond(model: ReducedModel, rows: RealArray, omega: float, orders: Sequence[int]) -> ComplexArray:
    """``(n_h, m)`` flexibility of each contact row by itself at harmonics of ``omega``, the diagonal of H [m/N]."""
    modes = find_normal_modes(model)
    if modes is None:
        return np.array([np.diagonal(receptance(model, h * omega, rows, rows.T)) for h in orders])
    return modes.gain(np.asarray(orders) * omega) @ (rows @ modes.shapes).T ** 2


def average(sizes: RealArray) -> RealArray:
    """Geometric mean over harmonics, ``(n_h, m)``, so that one which hits a resonance does not decide."""
    return np.exp(np.log(sizes).mean(axis=0))


def list_beyond(highest: int) -> tuple[int, ...]:
    """The first harmonics left out: a few of them, for a single one may hit a resonance."""
    return tuple(dict.fromkeys(round(highest * f) + 1 for f in (1.0, 1.25, 1.5)))
