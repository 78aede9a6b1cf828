"""What stands for the harmonics left out of a truncated friction force: springs where surroundings bend, or masses.

Beyond the highest harmonic a contact node moves against its elastic neighbourhood, or as a mass by itself. Its own
dynamic flexibility there tells which, and how soft the springs are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.model.receptance import find_normal_modes, measure_resistance, receptance
from ewr_fenicsx.model.reduced_model import ReducedModel

Closure = Literal["mass", "dashpot", "spring"]
# Ratio by which masses and springs may vary over the harmonics left out; share of a mass's motion that others may make
ALIKE, ALONE = 2.0, 0.05
# A pair has a spring of its own where its flexibility is alike at so many in a row of these multiples of the highest
# harmonic; and no less than this share of the static one: behind stiffer springs the mass of what they hold closes the
# truncation better
FAR, IN_A_ROW, LEAST_FAR = 2 ** np.arange(1, 9), 4, 3e-4
SEEN = 6, 24  # how far beyond the highest harmonic waves round a ring are seen: as far again, but within these
LEAST_ELASTIC = 0.15  # share of a pair's static flexibility, beyond the harmonics kept, above which it is a spring


def find_springs(
    model: ReducedModel, rows: RealArray, flexibility: RealArray, omega: float, highest: int, wave: int = 0
) -> RealArray:
    """``(m,)`` flexibility of contact rows beyond a highest harmonic, zero of those that move as masses [m/N].

    Behind a spring of its own a pair's flexibility is the same over many harmonics, which may begin far beyond
    (``find_own_springs``). Other pairs have one that falls: they are springs where much is left of it just beyond.

    Args:
        model: The reduced model.
        rows: ``(m, n)`` contact rows.
        flexibility: ``(m,)`` static flexibility of each by itself [m/N].
        omega: Angular frequency of the first harmonic [rad/s].
        highest: Highest harmonic that is kept.
        wave: Of a ring, in which the rows are seen.
    """
    try:
        beyond = average(np.abs(measure_beyond(model, rows, omega, list_beyond(highest), wave)))
    except ModelError:  # one hits an undamped mode exactly
        return np.zeros(len(rows))
    own = find_own_springs(model, rows, flexibility, omega, highest, wave)
    return np.where(own > 0, own, np.where(beyond > LEAST_ELASTIC * flexibility, beyond, 0.0))


def find_own_springs(
    model: ReducedModel, rows: RealArray, flexibility: RealArray, omega: float, highest: int, wave: int = 0
) -> RealArray:
    """``(m,)`` flexibility of contact rows behind springs of their own, zero of others [m/N]; as in ``find_springs``.

    Nothing but springs holds a node without mass of its own: above where what these are fixed to resonates on them, its
    flexibility is positive and alike over harmonics.
    """
    try:
        far = measure_beyond(model, rows, omega, highest * FAR, wave)
    except ModelError:  # one hits an undamped mode exactly
        return np.zeros(len(rows))
    some = sliding_window_view(far, IN_A_ROW, axis=0)
    size = np.abs(some)
    alike = np.all(some.real > np.abs(some.imag), axis=2) & (size.max(axis=2) < ALIKE * size.min(axis=2))
    nearest = size[alike.argmax(axis=0), np.arange(len(rows))]
    found = alike.any(axis=0) * average(nearest.T)
    return np.where(found > LEAST_FAR * flexibility, found, 0.0)


def find_masses(model: ReducedModel, rows: RealArray, omega: float, highest: int, wave: int = 0) -> RealArray:
    """``(m,)`` mass of contact rows that move beyond a highest harmonic as masses by themselves, zero of others [kg].

    Not of those that damping holds there more than inertia does.

    Args:
        model: The reduced model.
        rows: ``(m, n)`` rows along which pairs rub, all of them: they may not move each other.
        omega: Angular frequency of the first harmonic [rad/s].
        highest: Highest harmonic that is kept.
        wave: Of a ring, in which the rows are seen.
    """
    found, beyond = np.zeros(len(rows)), np.array(list_beyond(highest))
    try:
        if np.all(measure_beyond(model, rows, omega, beyond[:1], wave).real >= 0):  # mostly: one harmonic tells
            return found
        own, rates = measure_beyond(model, rows, omega, beyond, wave), beyond * omega
    except ModelError:  # one hits an undamped mode exactly
        return found
    inertia = -1 / (own * rates[:, None] ** 2)
    mass, damped = inertia.real, np.abs(inertia.imag)
    alike = (mass.min(axis=0) > 0) & (mass.max(axis=0) < ALIKE * mass.min(axis=0))
    alike = np.flatnonzero(alike & np.all(damped < mass, axis=0))
    if alike.size:
        moved = np.array([receptance(model, rate, rows, rows[alike].conj().T, wave) for rate in rates])
        others = np.abs(moved).sum(axis=1) - np.abs(own[:, alike])
        alone = alike[np.all(others < ALONE * np.abs(own[:, alike]), axis=0)]
        found[alone] = mass[:, alone].mean(axis=0)
    return found


def compare_waves(
    model: ReducedModel, read: Callable[[int], RealArray | ComplexArray], omega: float, highest: int
) -> RealArray:
    """``(m,)`` how many times softer rows are at the harmonics left out, in their waves, than in that of harmonic 1.

    Under a load of few waves round the ring neighbours all but move together at harmonic 1, and not there. Odd ones, at
    which friction acts most; against stiffness and inertia together, so that no resonance decides.

    Args:
        model: A sector of a ring.
        read: From a wave to the contact rows in it, ``(m, n)``.
        omega: Angular frequency of the first harmonic [rad/s].
        highest: Highest harmonic that is kept, an odd one.
    """
    usual, beyond = model.wave_of(1), np.arange(highest + 2, highest + np.clip(highest, *SEEN) + 1, 2)
    softer = np.zeros(len(read(usual)))
    for h in beyond.tolist():
        wave = model.wave_of(h)
        ways = (measure_resistance(model, read(w), h * omega, w) for w in (wave, usual))
        softer += np.divide(*ways) / beyond.size
    return softer


def measure_beyond(
    model: ReducedModel, rows: RealArray, omega: float, orders: Sequence[int], wave: int = 0
) -> ComplexArray:
    """``(n_h, m)`` flexibility of each contact row by itself at harmonics of ``omega``, the diagonal of H [m/N]."""
    modes = find_normal_modes(model, wave)
    if modes is None:
        return np.array([np.diagonal(receptance(model, h * omega, rows, rows.conj().T, wave)) for h in orders])
    return modes.gain(np.asarray(orders) * omega) @ np.abs(rows @ modes.shapes).T ** 2


def average(sizes: RealArray) -> RealArray:
    """Geometric mean over harmonics, ``(n_h, m)``, so that one which hits a resonance does not decide."""
    return np.exp(np.log(sizes).mean(axis=0))


def list_beyond(highest: int) -> tuple[int, ...]:
    """The first harmonics left out: a few of them, for a single one may hit a resonance."""
    return tuple(dict.fromkeys(round(highest * f) + 1 for f in (1.0, 1.25, 1.5)))
