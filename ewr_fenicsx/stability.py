"""What the signs of Jacobians' determinants tell of a periodic solution: the side of the folds, and instability.

Along a branch the sign changes at every simple fold, where a real Floquet multiplier crosses one, and else only where
branches cross. High harmonics enter the determinant as a complex number a row, that is by a square: solutions with more
and fewer of them can be compared. Each rigid coordinate turns it once, as the multiplier of a constraint does.

Seen over two periods, a solution has even harmonics only, and the Jacobian of the odd ones stands by itself. Its
determinant is positive but where an odd number of real multipliers are below minus one: motions in time then leave the
solution by alternating from period to period.

Source: Seydel (2010), Practical Bifurcation and Stability Analysis, doi:10.1007/978-1-4419-1740-9.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg

from ewr_fenicsx.balance import HarmonicBalance
from ewr_fenicsx.compliance import condense
from ewr_fenicsx.contact_problem import ContactSystem
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.harmonics import FourierBasis

MOST_UNKNOWNS = 3000  # of a Jacobian whose determinant is looked at: seconds
SINGULAR = 1e-12  # smallest pivot over the largest, below which rounding decides the sign: redundant pairs


def find_side(balance: HarmonicBalance, unknowns: RealArray) -> int:
    """Side of the folds that a solution is on.

    Args:
        balance: The balance.
        unknowns: Its solution, scaled, ``(size,)``.

    Returns:
        -1: an odd number of real Floquet multipliers are above one, and the solution is unstable. 1: an even number of
        them is, mostly none; it may be unstable in other ways. 0: there are too many unknowns to look, or the Jacobian
        is singular.
    """
    if balance.size > MOST_UNKNOWNS:
        return 0
    return find_sign(balance.linearise(unknowns).matrix()) * (-1) ** balance.rigid


def alternates(system: ContactSystem, forces: ComplexArray, rigid: RealArray) -> bool:
    """Whether an odd number of real Floquet multipliers are below minus one.

    Args:
        system: What was solved.
        forces: Its solution's contact forces ``(n_h, m)`` [N].
        rigid: Its rigid coordinates ``(r,)`` [m].

    Returns:
        False also where there are too many unknowns to look.
    """
    known = system.basis.orders
    doubled = see_over_two_periods(system)
    balance = HarmonicBalance(doubled, float(np.linalg.norm(forces)) or 1.0)
    if balance.size > MOST_UNKNOWNS:
        return False
    orders, spread = doubled.basis.orders, np.zeros((len(doubled.basis.orders), forces.shape[1]), dtype=complex)
    spread[[orders.index(2 * h) for h in known]] = forces
    odd = (np.array(orders)[doubled.basis.slot] % 2 == 1)[:, None]
    picked = np.append((odd & balance.unknown)[balance.unknown], np.zeros(balance.rigid, dtype=bool))
    jacobian = balance.linearise(balance.pack(spread, rigid)).matrix()
    return find_sign(jacobian[np.ix_(picked, picked)]) < 0


def see_over_two_periods(system: ContactSystem) -> ContactSystem:
    """The same system at half the frequency: every harmonic is twice as high, and odd ones come in between."""
    basis, twice = system.basis, lambda of: {2 * h: amplitude for h, amplitude in of.items()}
    orders = tuple(sorted({*(2 * h for h in basis.orders), *range(1, 2 * basis.orders[-1], 2)}))
    load, omega = twice(system.load), system.compliance.omega / 2
    return replace(
        system,
        load=load,
        prescribed=twice(system.prescribed),
        basis=FourierBasis(orders, 2 * basis.samples),
        compliance=condense(system.model, system.rows, load, omega, orders),
    )


def find_sign(matrix: RealArray) -> int:
    """Sign of a determinant; 0 where rounding decides it."""
    lu, rows, _ = scipy.linalg.lapack.dgetrf(matrix)
    pivots = np.diagonal(lu)
    if np.abs(pivots).min() <= SINGULAR * np.abs(pivots).max():
        return 0
    return (-1) ** int(np.count_nonzero(pivots < 0) + np.count_nonzero(rows != np.arange(rows.size)))
