"""Rigid motions of a structure: what its stiffness leaves free, to what rounding lets anybody tell.

Null vectors of the stiffness, found or given. Both are looked at in the stiffness's own units, so that no result
depends on those of the coordinates.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import RealArray

_EPS = float(np.finfo(float).eps)
# An eigenvalue of the scaled stiffness is zero up to so many roundings of the largest one (as many as there are
# coordinates, where these are more), and nobody can tell whether it is up to so many times that.
_ROUNDED, _DOUBTFUL = 100, 100
_NOTHING = 1e-12  # forces over those of the stiffest motion, that rounding may make where nothing resists
_MASSLESS = 1e-15  # energy of a rigid motion over the largest mass, below which it has no mass


def find_rigid_modes(stiffness: RealArray, precision: float = _EPS, mass: RealArray | None = None) -> RealArray:
    """Basis ``(n, r)`` of the null space of a positive semidefinite stiffness, orthonormal after diagonal scaling.

    Rounding of its entries leaves rigid motions a few times itself, whatever ``n``. A slender or locally refined body
    that is held may come within a hundred times that, and so may one that floats and has lost digits: which of the two
    it is, the stiffness does not tell.

    Args:
        stiffness: ``(n, n)``.
        precision: Relative rounding of its entries.
        mass: ``(n, n)``; it tells coordinates that nothing resists but rounding.

    Raises:
        ModelError: The stiffness has a negative eigenvalue beyond rounding, or one that rounding may have made or not.
    """
    n, scale = stiffness.shape[0], 1 / find_own_units(stiffness, mass)
    values, vectors = np.linalg.eigh(scale[:, None] * stiffness * scale)
    values = values / max(np.abs(values).max(), 1e-300)
    rounding = bound_rounding(n)
    doubtful = max(_DOUBTFUL * rounding, bound_rounding(n, precision))
    unsure = (np.abs(values) > rounding) & (np.abs(values) < doubtful)
    if np.any(unsure):
        lost = " is in single precision, and" if precision > _EPS else ""
        raise ModelError(
            f"the stiffness{lost} resists {np.count_nonzero(unsure)} motions by no more than rounding may make: "
            f"{np.abs(values[unsure]).min():.1g} of the most, where lost digits leave up to {doubtful:.1g}. Say "
            f"whether a body floats: rigid_modes=np.zeros(({n}, 0)) if all are held, or its rigid modes as columns"
        )
    if values[0] < -doubtful:
        raise ModelError(
            f"stiffness is not positive semidefinite: scaled eigenvalue {values[0]:.3g}; check its assembly, "
            "or whether its entries have lost digits, as in a file of few: then give more of them, or rigid_modes"
        )
    return scale[:, None] * vectors[:, values <= rounding]


def find_precision(matrix: object) -> float:
    """Relative rounding of the entries of a matrix as it is given, before it is read."""
    kind = np.dtype(getattr(matrix, "dtype", float))
    return float(max(_EPS, np.finfo(kind).eps)) if kind.kind in "fc" else _EPS


def bound_rounding(size: int, precision: float = _EPS) -> float:
    """What rounding may make of an eigenvalue that is zero, over the largest: of a matrix ``(size, size)``."""
    return max(_ROUNDED, size) * precision


def check_rigid_modes(stiffness: RealArray, mass: RealArray, modes: RealArray) -> RealArray:
    """That given modes ``(n, r)`` are all rigid motions that there are, and nothing else.

    Returns:
        The stiffness ``(n, n)``, without what rounding left at coordinates that are rigid motions by themselves, as
        those across two pads on which a body stands. It would pass for their own units, and for springs of any sign.

    Raises:
        ModelError: One meets elastic forces, or the stiffness leaves other motions free, too.
    """
    stiffness = _clear_rounding(stiffness, mass, modes)
    force = np.abs(stiffness @ modes).max(axis=0)
    scale = np.maximum((np.abs(stiffness) @ np.abs(modes)).max(axis=0), np.finfo(float).tiny)  # no stiffness at all
    rounding = _NOTHING * np.abs(stiffness).max(initial=0.0) * np.abs(modes).max(axis=0, initial=0.0)
    meets = np.where(force > rounding, force / scale, 0.0)
    if np.any(meets > 1e-6):
        worst = int(np.argmax(meets))
        raise ModelError(
            f"rigid_modes[:, {worst}] meets elastic forces of {meets[worst]:.2g} of the stiffness; "
            "give null vectors of the stiffness, None to have them found, or a stiffness whose entries have more digits"
        )
    _check_completeness(stiffness, modes)
    return stiffness


def _clear_rounding(stiffness: RealArray, mass: RealArray, modes: RealArray) -> RealArray:
    """The stiffness with zeros at coordinates whose own motion the modes contain, where it is rounding."""
    if modes.size == 0:
        return stiffness
    heavy, rounding = find_own_units(mass, stiffness), bound_rounding(len(modes))
    share, own = np.sum(scipy.linalg.orth(heavy[:, None] * modes) ** 2, axis=1), np.abs(np.diag(stiffness)) / heavy**2
    free = (share > 1 - _NOTHING) & (own <= rounding * own.max())
    cleared = np.where(free[:, None] | free, 0.0, stiffness)
    # a mass far above all others has springs, though they hardly move it: without them the modes would meet forces
    met, allowed = (np.abs(matrix @ modes) for matrix in (cleared, stiffness))
    return cleared if np.all(met <= allowed + rounding * (np.abs(stiffness) @ np.abs(modes))) else stiffness


def check_inertia(mass: RealArray, stiffness: RealArray, modes: RealArray) -> None:
    """That every rigid motion has kinetic energy: a coordinate with neither mass nor stiffness has none.

    Raises:
        ModelError: One has none.
    """
    if modes.shape[1] == 0:
        return
    root = find_own_units(stiffness, mass)
    apart, scaled = scipy.linalg.orth(root[:, None] * modes), mass / root[:, None] / root
    energies, motions = np.linalg.eigh(apart.T @ scaled @ apart)
    if energies[0] <= _MASSLESS * np.abs(scaled).max():
        moved = int(np.argmax(np.abs(apart @ motions[:, 0])))
        raise ModelError(
            f"the stiffness leaves {modes.shape[1]} rigid motions free, and the mass is zero in one of them: it "
            f"moves coordinate {moved} most, where neither a mass nor a spring resists; a dashpot alone does not do; "
            "give it a mass, hold it, or leave it out"
        )


def find_own_units(stiffness: RealArray, mass: RealArray | None = None) -> RealArray:
    """``(n,)`` roots of the stiffness's own diagonal, by which results do not depend on the coordinates' units.

    Where it is zero, or beside others by itself and mass by mass no more than rounding, of the mass's: as stiff as the
    softest of the others, mass by mass.
    """
    stiff = np.abs(np.diag(stiffness))
    heavy = np.zeros(stiff.size) if mass is None else np.abs(np.diag(mass))
    both, rounding = (stiff > 0) & (heavy > 0), bound_rounding(stiff.size)
    squares = np.divide(stiff, heavy, out=np.full(stiff.size, np.inf), where=both)
    rounded = np.maximum(stiff / max(stiff.max(), 1e-300), squares / squares[both].max(initial=1e-300)) < rounding
    stiff, both = np.where(rounded, 0.0, stiff), both & ~rounded
    softest = np.min(stiff[both] / heavy[both]) if np.any(both) else 1.0
    squares = np.where(stiff > 0, stiff, softest * heavy)
    return np.sqrt(np.where(squares > 0, squares, 1.0))


def _check_completeness(stiffness: RealArray, modes: RealArray) -> None:
    """That the stiffness resists what is no rigid mode: another Cholesky factorisation."""
    n, root = stiffness.shape[0], find_own_units(stiffness)
    apart = scipy.linalg.orth(root[:, None] * modes) if modes.size else modes
    scaled = stiffness / root[:, None] / root
    resisted = scaled + apart @ apart.T
    rounding = bound_rounding(n)
    try:
        np.linalg.cholesky(resisted - _DOUBTFUL * rounding * np.eye(n))
        complete = True
    except np.linalg.LinAlgError:  # eigenvalues tell what is near rounding apart from it
        values = np.linalg.eigvalsh(resisted)
        complete = values[0] > rounding * values[-1]
    if not complete or apart.shape[1] < modes.shape[1]:
        values = np.linalg.eigvalsh(scaled)
        raise ModelError(
            f"rigid_modes has {modes.shape[1]} columns, {apart.shape[1]} of them independent, and the stiffness leaves "
            f"{np.count_nonzero(values <= rounding * values[-1])} motions free; give one for each of these, or None to "
            "have them found"
        )
