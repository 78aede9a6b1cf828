"""Hill's matrix: deviations that grow by ``exp(s t)`` while they vary with the period, on the solution's harmonics.

With amplitudes from harmonic -N to N of modal coordinates a, their velocities b and contact forces lam, and the
exponents ``z = s + i h omega`` of the harmonics, deviations obey::

    z a = b,     z M b = -D b - K a + R^T lam
    dpsi/dlam lam + dpsi/dq (R a + F lam) + dpsi/dv (R b + z F lam) = 0

R is what the contact rows see of the modes that follow, F their flexibility by the others (``deviations.py``). That is
linear in s, and has no poles: Arnoldi's method finds the exponents near a guess. For one exponent all but the forces
of rows that change status are eliminated harmonic by harmonic; what is left is Hill's matrix.

Source: Lazarus and Thomas (2010), A harmonic-based method for computing the stability of periodic solutions,
doi:10.1016/j.crme.2010.07.020; shift-and-invert: Saad (2011), Numerical Methods for Large Eigenvalue Problems,
doi:10.1137/1.9781611970739.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.linalg
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs

from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.in_time.deviations import Slopes, eliminate_steady
from ewr_fenicsx.in_time.followed_modes import Followed, follow_modes
from ewr_fenicsx.problem.contact_system import ContactSystem

NEAREST, SPACE, RESTARTS = 3, 24, 10  # exponents looked for near a guess; vectors of Arnoldi's method, how often anew
TOLERANCE = 1e-6  # of an exponent's distance from the guess
FOLLOWS = 6.0  # highest frequency of the modes that follow, over that of the highest harmonic
SMALL = 60  # unknowns, up to which all exponents are computed
SINGULAR = 1e-13  # smallest pivot over the largest, below which forces are not unique, whatever the exponent


class Hill:
    """The deviations of one exponent.

    Args:
        system: What was solved.
        slopes: The laws' derivatives, at any number of samples more than twice the highest harmonic.
        exponent: s [1/s].
        top: N.
        modes: The modes that follow; of waves, one for each harmonic from -N to N. None: those of ``system``.

    Raises:
        LinAlgError: Redundant pairs share their forces in any way.
    """

    def __init__(
        self, system: ContactSystem, slopes: Slopes, exponent: complex, top: int, modes: Followed | None = None
    ):
        self.exponent, self.slopes = exponent, slopes
        self.m = len(system.rows)
        self.orders = np.arange(-top, top + 1)
        self.z = exponent + 1j * self.orders * system.compliance.omega
        self.modes = modes or follow_modes(system, FOLLOWS * top * system.compliance.omega)
        solved = eliminate_steady(self.modes, slopes, self.z)
        self.answer, self.flexibility, self.steady_inverse, self.follow = solved

    @cached_property
    def matrix(self) -> ComplexArray:
        """Hill's matrix ``(n, n)`` for ``n = (2 N + 1) x``, on the forces of the rows that change status."""
        count, x, samples = self.orders.size, self.slopes.changing.size, self.slopes.samples
        motions = self.flexibility @ self.follow
        seen = {"force": self.follow, "displacement": motions, "velocity": self.z[:, None, None] * motions}
        matrix = np.zeros((count, x, count, x), dtype=complex)
        pick = np.subtract.outer(self.orders, self.orders) % samples
        for slope in self.slopes.at_changing:
            spectrum = np.fft.fft(slope.values, axis=0)[pick] / samples  # harmonic of the law, of the force, row
            by_force = np.moveaxis(seen[slope.variable][:, slope.columns], 0, 1)  # row, harmonic, force
            matrix[:, slope.at] += np.moveaxis(spectrum, 2, 1)[:, :, :, None] * by_force
        return matrix.reshape((count * x,) * 2)

    @cached_property
    def factors(self) -> tuple[ComplexArray, np.ndarray]:
        """Of ``matrix``.

        Raises:
            LinAlgError: It is singular.
        """
        factors = scipy.linalg.lapack.zgetrf(self.matrix)[:2]
        pivots = np.abs(np.diagonal(factors[0]))
        if not pivots.min(initial=np.inf) > SINGULAR * pivots.max(initial=0.0):
            raise np.linalg.LinAlgError("forces are not unique")
        return factors

    def find_nearest(self, few: int = NEAREST) -> tuple[ComplexArray, ComplexArray]:
        """The exponents nearest to this one [1/s], and their modal coordinates ``(few, 2 N + 1, p)``.

        Raises:
            LinAlgError: Redundant pairs share their forces in any way.
        """
        size = self.orders.size * (2 * self.modes.count + self.m)
        if size <= SMALL:
            values, states = np.linalg.eig(np.array([self.invert(unit) for unit in np.eye(size)]).T)
        else:
            start = self.invert(self.invert(np.random.default_rng(0).standard_normal(size) + 0j))
            operator = LinearOperator((size, size), matvec=self.invert, dtype=complex)
            arnoldi = {"ncv": SPACE, "v0": start, "maxiter": RESTARTS, "tol": TOLERANCE}
            try:
                values, states = eigs(operator, few, **arnoldi)
            except ArpackNoConvergence as found:
                values, states = found.eigenvalues, found.eigenvectors
        nearest = np.argsort(-np.abs(values))[:few]
        nearest = nearest[np.abs(values[nearest]) > 0]
        motion = states[: self.orders.size * self.modes.count, nearest]
        return self.exponent + 1 / values[nearest], motion.T.reshape(nearest.size, self.orders.size, self.modes.count)

    def invert(self, vector: ComplexArray) -> ComplexArray:
        """``(A - s B)^-1 B`` times a vector ``(a, b, lam)``, for the equations above as ``A y = s B y``."""
        modes, z, count, p = self.modes, self.z[:, None], self.orders.size, self.modes.count
        a, b, forces = np.split(vector, [count * p, 2 * count * p])
        a, b, forces = a.reshape(count, p), b.reshape(count, p), forces.reshape(count, self.m)
        pushed = -_multiply(modes.mass, b + z * a) - _multiply(modes.damping, a)
        moved = _multiply(self.answer, pushed)  # without forces
        motion = _multiply(modes.rows, moved)
        velocity = _multiply(modes.rows, a + z * moved) + _multiply(modes.rest, forces)
        told = self.weigh({"displacement": motion, "velocity": velocity})
        s, x = self.slopes.steady, self.slopes.changing
        solved = np.zeros((count, self.m), dtype=complex)
        solved[:, s] = -_multiply(self.steady_inverse, told[:, s])
        motion = _multiply(self.flexibility, solved)
        told += self.weigh({"force": solved, "displacement": motion, "velocity": z * motion})
        left = scipy.linalg.lu_solve(self.factors, -told[:, x].ravel(), check_finite=False).reshape(count, x.size)
        solved += _multiply(self.follow, left)
        moved += _multiply(self.answer, _multiply(np.conj(modes.rows).swapaxes(-1, -2), solved))
        return np.concatenate([moved.ravel(), (a + z * moved).ravel(), solved.ravel()])

    def weigh(self, variables: dict[str, ComplexArray]) -> ComplexArray:
        """The laws' equations ``(2 N + 1, m)`` of variables ``(2 N + 1, m)``."""
        slopes, told = self.slopes, np.zeros((self.orders.size, self.m), dtype=complex)
        told[:, slopes.steady] = sum(value @ slopes.at_steady[name].T for name, value in variables.items())
        sampled = np.zeros((slopes.samples, slopes.changing.size), dtype=complex)
        histories = {}
        for name, value in variables.items():
            spread = np.zeros((slopes.samples, self.m), dtype=complex)
            spread[self.orders] = value
            histories[name] = np.fft.ifft(spread, axis=0)
        for slope in slopes.at_changing:
            if slope.variable in histories:
                sampled[:, slope.at] += slope.values * histories[slope.variable][:, slope.columns]
        told[:, slopes.changing] = np.fft.fft(sampled, axis=0)[self.orders]
        return told


def measure_edges(motions: ComplexArray) -> RealArray:
    """``(k,)`` share of deviations ``(k, 2 N + 1, p)`` at the outermost harmonics, two on either side, or one.

    Where it is large a deviation is cut off there, and its exponent is none; nor is that of what does not move.
    """
    shares = np.sum(np.abs(motions) ** 2, axis=2)
    few = min(2, shares.shape[1] // 2)
    outermost, whole = shares[:, :few].sum(axis=1) + shares[:, -few:].sum(axis=1), shares.sum(axis=1)
    return np.divide(outermost, whole, out=np.ones_like(whole), where=whole > 0)


def _multiply(matrices: np.ndarray, vectors: ComplexArray) -> ComplexArray:
    """A product at each harmonic, ``(2 N + 1, ...)``, by a matrix for each or the same for all."""
    return np.matmul(matrices, vectors[..., None])[..., 0]
