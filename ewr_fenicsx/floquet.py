"""Floquet multipliers: whether small deviations from a periodic solution grow from period to period, turning or not.

A pair of complex multipliers beyond the unit circle changes no sign of a determinant (``stability.py``): motions leave
in a spiral, mostly for one that never repeats.

Three steps, each only where the one before lets deviations grow. They are stepped through the period from every unit
state, for a guess (``deviations.py``): this displaces the instants at which pairs change status by up to half a sample,
and by itself would call some stable solutions unstable. They are stepped along the motion in time that begins on the
solution: truncated, many pairs that lift off may do so where the laws would not have it. What counts are the exponents
nearest to a guess on the solution's harmonics (``hill.py``).

Source: Seydel (2010), Practical Bifurcation and Stability Analysis, doi:10.1007/978-1-4419-1740-9.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from ewr_fenicsx.contact_problem import ContactProblem
from ewr_fenicsx.contact_system import ContactSystem
from ewr_fenicsx.deviations import Slopes, differentiate_along, differentiate_laws, step_deviations
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.hill import Hill
from ewr_fenicsx.stability import find_sign

MOST_UNKNOWNS = 1500  # of Hill's matrix: half a second
FEWEST = 5  # harmonics of the deviations, below which it is not looked at, but where the solution has no more
STEPS, TRUSTED = (256, 128), 1e3  # a period; multiplier above which fewer are taken: it grows with their number
GROWTH = 1.02  # a period, from which on it counts: less is within the errors of truncation, also of many harmonics
GUESSES = 3  # at most
REAL = 1e-3  # imaginary part of a multiplier over its modulus, up to which it counts as real
SLOW = 1e-4  # exponent over the angular frequency that stands for none: at none, what sticks throughout is neutral


def find_growth(problem: ContactProblem, forces: ComplexArray, rigid: RealArray, coordinates: ComplexArray) -> complex:
    """The largest Floquet multiplier beyond the unit circle.

    Args:
        problem: What was solved, with a closure that does not remember.
        forces: Its solution's contact forces ``(n_h, m)`` [N].
        rigid: Its rigid coordinates ``(r,)`` [m].
        coordinates: Its amplitudes ``(n_h, n)``.

    Returns:
        The one of a pair with positive imaginary part; 0 where none is, where too many rows change status to look, and
        where a law remembers.
    """
    system = problem.system
    top, rows = system.basis.orders[-1], system.rows.shape[0]
    if not (top and rows):
        return 0.0
    slopes = differentiate_laws(system, forces, rigid, system.basis.samples)
    if slopes is not None and not slopes.changing.size:
        slopes = slopes.treat_all_as_changing()
    if slopes is None or count_harmonics(system, slopes) < min(top, FEWEST):
        return 0.0
    try:
        guesses = guess_multipliers(system, forces, rigid)
        if guesses.size and is_borne_out(problem, coordinates):
            found = (refine(system, slopes, guess) for guess in guesses)
            return next(filter(None, found), 0.0)
    except np.linalg.LinAlgError:  # redundant pairs share their forces in any way
        return 0.0
    return 0.0


def is_borne_out(problem: ContactProblem, coordinates: ComplexArray) -> bool:
    """Whether deviations grow along the motion in time that begins on a solution; True where it cannot be stepped."""
    try:
        slopes = differentiate_along(problem, coordinates)
    except (ModelError, ImportError):
        return True
    return slopes is None or measure_growth(step_deviations(problem.system, slopes)) > GROWTH


def measure_growth(whole: RealArray) -> float:
    """Modulus of the largest multiplier of a monodromy matrix; infinite where stepping overflowed."""
    return float(np.abs(np.linalg.eigvals(whole)).max(initial=0.0)) if np.all(np.isfinite(whole)) else np.inf


def guess_multipliers(system: ContactSystem, forces: ComplexArray, rigid: RealArray) -> ComplexArray:
    """The largest multipliers beyond the unit circle that stepping sees, few, one of each pair."""
    for steps in STEPS:
        whole = step_deviations(system, differentiate_laws(system, forces, rigid, 2 * steps))
        if measure_growth(whole) < TRUSTED:
            break
    found = np.linalg.eigvals(whole)
    found = found[(np.abs(found) > GROWTH) & (found.imag >= 0)]
    return found[np.argsort(-np.abs(found))][:GUESSES]


def refine(system: ContactSystem, slopes: Slopes, guess: complex) -> complex:
    """The largest of the multipliers near a guess that count; 0 where none does.

    An exponent plus any harmonic's frequency is one as well; of these truncation spares those in the middle.
    """
    omega, top = system.compliance.omega, count_harmonics(system, slopes)
    exponents, harmonics = Hill(system, slopes, np.log(complex(guess)) * omega / (2 * np.pi), top).find_nearest()
    multipliers = np.exp(2 * np.pi * exponents[np.abs(harmonics) <= top / 2] / omega)
    found = max(multipliers, key=abs, default=0.0)
    return complex(found.real, abs(found.imag)) if abs(found) > GROWTH else 0.0


def count_harmonics(system: ContactSystem, slopes: Slopes) -> int:
    """Highest harmonic of the deviations: that of the solution, or the highest for which Hill's matrix is not large."""
    return min(system.basis.orders[-1], (MOST_UNKNOWNS // slopes.changing.size - 1) // 2)


def grows(system: ContactSystem, forces: ComplexArray, rigid: RealArray) -> bool | None:
    """Whether an odd number of real Floquet multipliers are above one: Hill's determinant is negative there.

    The Jacobian of the balance tells as much where every force follows from the motion. Mean friction does not: what
    sets it (``static_friction``) turns the sign where friction is strong enough to wedge, without any motion leaving.

    Args:
        system: What was solved.
        forces, rigid: As in ``find_growth``.

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
    hill = Hill(system, slopes.treat_all_as_changing(), SLOW * omega, top)
    matrix = transform.conj().T @ hill.matrix @ transform
    return find_sign(matrix.real) < 0


def tell_where_to(alternates: bool, multiplier: complex) -> str:
    """Where motions most often go that leave a solution, and how to see it; words to follow on "leave it"."""
    turns = abs(multiplier.imag) > REAL * abs(multiplier)
    kind = "repeats every second period" if alternates else "never repeats" if turns else ""
    often = f", most often for one that {kind}" if kind else ""
    return f"{often}; integrate(problem, solution, tolerance=0) shows where to"
