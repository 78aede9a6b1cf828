"""Floquet multipliers: whether small deviations from a periodic solution grow from period to period, turning or not.

A pair of complex multipliers beyond the unit circle changes no sign of a determinant (``stability.py``): motions leave
in a spiral, mostly for one that never repeats. Deviations obey the laws' derivatives at the solution::

    M x'' + D x' + K x = B^T lam,      dpsi/dlam lam + dpsi/dq B x + dpsi/dv B x' = 0

Two steps. Deviations are stepped through the period from every unit state, for a guess: this displaces the instants at
which pairs change status by up to half a sample, and by itself would call some stable solutions unstable. With
deviations ``exp(s t)`` times a periodic motion, Hill's determinant over the solution's harmonics must vanish near by.

Source: Seydel (2010), Practical Bifurcation and Stability Analysis, doi:10.1007/978-1-4419-1740-9; the scheme (SDIRK2,
L-stable: contact nodes without mass do not ring): Alexander (1977), doi:10.1137/0714068.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import scipy.linalg
from scipy import sparse

from ewr_fenicsx.balance import HarmonicBalance
from ewr_fenicsx.contact_system import ContactSystem
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.harmonics import FourierBasis
from ewr_fenicsx.stability import find_sign

MOST_COORDINATES, MOST_UNKNOWNS = 40, 1500  # of a model and of Hill's determinant: a fraction of a second each
STEPS = 512  # a period, at least
GROWTH = 1.02  # a period, from which on it counts: less is within the errors of truncation, also of many harmonics
SHARE = 1 - 1 / np.sqrt(2)  # of a step, at which the scheme's first stage lies
GUESSES, REFINEMENTS = 3, 12  # at most: of multipliers, and of the exponent of each
REAL = 1e-3  # imaginary part of a multiplier over its modulus, up to which it counts as real
SETTLED = 1e-8  # last change of an exponent over the angular frequency
SLOW = 1e-4  # exponent over the angular frequency that stands for none: at none, what sticks throughout is neutral
VARIABLES = ("force", "displacement", "velocity")  # by which deviations see the laws: nothing is remembered

Slopes = Mapping[str, RealArray]  # variable -> (n_t, m, m) derivatives of all laws


def find_growth(system: ContactSystem, forces: ComplexArray, rigid: RealArray) -> complex:
    """The largest Floquet multiplier beyond the unit circle.

    Args:
        system: What was solved.
        forces: Its solution's contact forces ``(n_h, m)`` [N].
        rigid: Its rigid coordinates ``(r,)`` [m].

    Returns:
        The one of a pair with positive imaginary part; 0 where none is, where the model is too large to look, and where
        a law remembers.
    """
    top, rows = system.basis.orders[-1], system.rows.shape[0]
    small = system.model.size <= MOST_COORDINATES and (2 * top + 1) * rows <= MOST_UNKNOWNS
    if not (top and rows and small):
        return 0.0
    slopes = differentiate_laws(system, forces, rigid, 2 * max(STEPS, system.basis.samples))
    if slopes is None:
        return 0.0
    try:
        stepped = np.linalg.eigvals(step_deviations(system, slopes))
        guesses = sorted(stepped[(np.abs(stepped) > GROWTH) & (stepped.imag >= 0)], key=abs, reverse=True)[:GUESSES]
        if not guesses:
            return 0.0
        matrix_at = hill_matrix(system, differentiate_laws(system, forces, rigid, system.basis.samples))
        found = max((refine(matrix_at, guess, system.compliance.omega) for guess in guesses), key=abs)
    except np.linalg.LinAlgError:  # redundant pairs share their forces in any way
        return 0.0
    return complex(found.real, abs(found.imag)) if abs(found) > GROWTH else 0.0


def grows(system: ContactSystem, forces: ComplexArray, rigid: RealArray) -> bool | None:
    """Whether an odd number of real Floquet multipliers are above one: Hill's determinant is negative there.

    The Jacobian of the balance tells as much where every force follows from the motion. Mean friction does not: what
    sets it (``static_friction``) turns the sign where friction is strong enough to wedge, without any motion leaving.

    Args:
        system, forces, rigid: As in ``find_growth``.

    Returns:
        None where a law remembers.
    """
    slopes = differentiate_laws(system, forces, rigid, system.basis.samples)
    if slopes is None:
        return None
    top, omega = system.basis.orders[-1], system.compliance.omega
    to_complex = np.zeros((2 * top + 1, 2 * top + 1), dtype=complex)  # from mean, cosines and sines
    to_complex[top, top], h = 1.0, np.arange(1, top + 1)
    to_complex[top + h, top + h] = to_complex[top - h, top + h] = np.sqrt(0.5)
    to_complex[top + h, top - h], to_complex[top - h, top - h] = -1j * np.sqrt(0.5), 1j * np.sqrt(0.5)
    transform = sparse.kron(to_complex, sparse.identity(system.rows.shape[0]), format="csr")
    matrix = transform.conj().T @ hill_matrix(system, slopes)(SLOW * omega) @ transform
    return find_sign(matrix.real) < 0


def tell_where_to(alternates: bool, multiplier: complex) -> str:
    """Where motions most often go that leave a solution, and how to see it; words to follow on "leave it"."""
    turns = abs(multiplier.imag) > REAL * abs(multiplier)
    kind = "repeats every second period" if alternates else "never repeats" if turns else ""
    often = f", most often for one that {kind}" if kind else ""
    return f"{often}; integrate(problem, solution, tolerance=0) shows where to"


def differentiate_laws(system: ContactSystem, forces: ComplexArray, rigid: RealArray, samples: int) -> Slopes | None:
    """Derivatives of all laws at a solution; None where one is by something else than ``VARIABLES``, or remembers."""
    sampled = replace(system, basis=FourierBasis(system.basis.orders, samples))
    balance = HarmonicBalance(sampled, float(np.linalg.norm(forces)) or 1.0)
    rows = system.rows.shape[0]
    slopes = {variable: np.zeros((samples, rows, rows)) for variable in VARIABLES}
    for d in balance.linearise(balance.pack(forces, rigid)).derivatives:
        if d.since is not None or d.variable not in slopes:
            return None
        slopes[d.variable][:, d.rows, d.columns] += d.values
    return slopes


def step_deviations(system: ContactSystem, slopes: Slopes) -> RealArray:
    """What a period makes of small deviations: the monodromy matrix.

    Args:
        system: The system.
        slopes: Sampled twice a step.

    Returns:
        ``(2 n, 2 n)`` on deviations of coordinates and velocities at ``tau = 0``.
    """
    model, rows, samples = system.model, system.rows, len(slopes["force"])
    dt = 4 * np.pi / (system.compliance.omega * samples)
    h, n = SHARE * dt, model.size
    inverse = np.linalg.inv(model.mass / h**2 + model.damping / h + model.stiffness)
    free = inverse @ np.hstack([model.mass / h**2 + model.damping / h, model.mass / h])
    push, at_rest = inverse @ rows.T, np.eye(n, 2 * n)
    seen = rows @ free
    passed = (seen - rows @ at_rest) / h

    def advance(first: int) -> RealArray:
        """``(samples / 2, 2 n, 2 n)`` an implicit step over h, on every second sample from the first one."""
        force, displacement, velocity = (np.roll(slopes[name], -first, axis=0)[::2] for name in VARIABLES)
        held = force + (displacement + velocity / h) @ (rows @ push)
        x = free - push @ np.linalg.solve(held, displacement @ seen + velocity @ passed)
        return np.concatenate([x, (x - at_rest) / h], axis=1)

    one = advance(round(2 * SHARE))
    rate = (one - np.eye(2 * n)) / h  # of coordinates and velocities, at the first stage
    steps = advance(2) @ (np.eye(2 * n) + (1 - SHARE) * dt * rate)
    whole = np.eye(2 * n)
    for step in steps:
        whole = step @ whole
    return whole


def hill_matrix(system: ContactSystem, slopes: Slopes) -> Callable[[complex], ComplexArray]:
    """Hill's matrix of the condensed system as a function of the exponent s [1/s], ``(n, n)`` for ``n = (2 N + 1) m``.

    Deviations are ``exp(s t)`` times harmonics from -N to N, whose complex amplitudes of contact forces it acts on.
    """
    model, rows = system.model, system.rows
    top, m, samples = system.basis.orders[-1], rows.shape[0], len(slopes["force"])
    orders = np.arange(-top, top + 1)
    pick = np.subtract.outer(orders, orders) % samples
    force, displacement, velocity = (np.fft.fft(slopes[name], axis=0) / samples for name in VARIABLES)

    def at(s: complex) -> ComplexArray:
        matrix = np.empty((orders.size, m, orders.size, m), dtype=complex)
        for k, z in enumerate(s + 1j * orders * system.compliance.omega):
            flexibility = rows @ np.linalg.solve(model.stiffness + z * model.damping + z**2 * model.mass, rows.T)
            matrix[:, :, k] = force[pick[:, k]] + (displacement + z * velocity)[pick[:, k]] @ flexibility
        return matrix.reshape((orders.size * m,) * 2)

    return at


def refine(matrix_at: Callable[[complex], ComplexArray], guess: complex, omega: float) -> complex:
    """The multiplier near a guess at which Hill's matrix is singular; 0 where none is found.

    Newton's method on the matrix's smallest singular value, whose vectors inverse iteration finds.
    """
    s = np.log(complex(guess)) * omega / (2 * np.pi)
    start = np.random.default_rng(0).standard_normal(len(matrix_at(s))) + 0j
    left, right = start, start
    for _ in range(REFINEMENTS):
        matrix, nudge = matrix_at(s), 1e-6 * omega
        slope = (matrix_at(s + nudge) - matrix) / nudge
        off = np.finfo(float).eps * np.linalg.norm(matrix)  # from exactly singular
        factors = scipy.linalg.lu_factor(matrix + off * np.eye(len(matrix)), check_finite=False)
        for _ in range(2):
            right = scipy.linalg.lu_solve(factors, slope @ right, check_finite=False)
            left = scipy.linalg.lu_solve(factors, slope.conj().T @ left, trans=2, check_finite=False)
            if not (np.any(right) and np.any(left)):  # singular whatever the exponent: forces are not unique
                return 0.0
            right, left = right / np.linalg.norm(right), left / np.linalg.norm(left)
        change = (left.conj() @ matrix @ right) / (left.conj() @ slope @ right)
        if not abs(change) < omega:  # it runs away
            return 0.0
        s -= change
        if abs(change) < SETTLED * omega:
            return complex(np.exp(2 * np.pi * s / omega))
    return 0.0
