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

from ewr_fenicsx.balance.balance import HarmonicBalance, pose_at
from ewr_fenicsx.balance.law_derivatives import Derivative
from ewr_fenicsx.balance.newton_step import NewtonStep
from ewr_fenicsx.balance.periodic_motion import PeriodicMotion
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.model.compliance import condense
from ewr_fenicsx.problem.contact_system import ContactSystem
from ewr_fenicsx.problem.harmonics import FourierBasis

MOST_UNKNOWNS = 3000  # of a Jacobian whose determinant is looked at: a second
# A highest harmonic, at least, at which it is looked who opens and closes: with the few of a solution that is to be
# accurate to some per cent, instants are so far off that the sign is that of another stiffness.
SAMPLES = 64
SINGULAR = 1e-12  # smallest pivot over the largest, below which rounding decides the sign: redundant pairs


def find_side(balance: HarmonicBalance, unknowns: RealArray) -> int:
    """Side of the folds that a solution is on.

    Args:
        balance: The balance.
        unknowns: Its solution, scaled, ``(size,)``.

    Returns:
        -1: an odd number of real Floquet multipliers are above one, and the solution is unstable, or mean friction
        wedges (``floquet.grows`` tells which). 1: an even number of them is, mostly none; it may be unstable in other
        ways. 0: there are too many unknowns to look, or the Jacobian is singular.
    """
    if balance.size > MOST_UNKNOWNS:
        return 0
    return find_sign(balance.linearise(unknowns).matrix()) * (-1) ** balance.rigid


def alternates(motion: PeriodicMotion) -> bool:
    """Whether an odd number of real Floquet multipliers are below minus one, of a solution with a row at least.

    Returns:
        False also where one harmonic alone has too many unknowns to look, where there is none, where one in between
        hits an undamped mode exactly, and of a sector of a ring.
    """
    system = motion.problem.system
    count = min(system.basis.orders[-1], MOST_UNKNOWNS // (2 * motion.forces.shape[1]))
    if not count or system.model.cyclic:
        return False
    times = -(-SAMPLES * system.basis.orders[-1] // system.basis.samples)
    system = system.sample(times * system.basis.samples)  # its own are among them
    solved, unknowns = pose_at(system, motion.forces, motion.rigid)
    try:
        between = HarmonicBalance(see_between(system, count), solved.force_unit)
    except ModelError:
        return False
    derivatives = solved.linearise(unknowns).derivatives
    step = NewtonStep(between, tuple(map(repeat, derivatives)), np.zeros(between.size))
    return find_sign(step.matrix()) < 0


def see_between(system: ContactSystem, count: int) -> ContactSystem:
    """The system over two periods at the ``count`` lowest harmonics in between its own: the odd ones.

    Raises:
        ModelError: One of these hits an undamped mode exactly.
    """
    orders, omega = tuple(range(1, 2 * count, 2)), system.compliance.omega / 2
    basis = FourierBasis(orders, 2 * system.basis.samples)
    compliance = condense(system.model, system.rows, {}, omega, orders)
    return replace(system, load={}, prescribed={}, basis=basis, compliance=compliance)


def repeat(derivative: Derivative) -> Derivative:
    """A derivative over two periods that are alike; what reaches back to before the first counts from the second."""
    values, since = np.tile(derivative.values, (2, 1)), derivative.since
    kept = None if derivative.kept is None else np.tile(derivative.kept, (2, 1))
    if since is not None:
        count = len(since)
        before = since > np.arange(count)[:, None]
        later = np.where(since < 0, since, since + count)
        since = np.vstack([np.where(before, later, since), np.where(before, since, later)])
    return replace(derivative, values=values, since=since, kept=kept)


def find_sign(matrix: RealArray) -> int:
    """Sign of a determinant; 0 where rounding decides it, 1 of an empty matrix."""
    if matrix.size == 0:
        return 1
    lu, rows, _ = scipy.linalg.lapack.dgetrf(matrix)
    pivots = np.diagonal(lu)
    if np.abs(pivots).min() <= SINGULAR * np.abs(pivots).max():
        return 0
    return (-1) ** int(np.count_nonzero(pivots < 0) + np.count_nonzero(rows != np.arange(rows.size)))
