"""Newton's path: from a start to a solution from corner to corner, where all laws are linear in between.

With contact that opens and friction along a line, the balance ``r(z)`` is linear as long as no pair changes status at
any sample. From a start ``z_0`` the path ``r(z) = (1 - s) r(z_0)`` is then a chain of straight pieces. Where a pair
changes status at a sample, a corner, the Jacobian changes by a matrix of rank one: the next piece costs one more right
side, no factorisation. Where that turns the sign of the determinant, s runs backwards on the next piece: a fold.

Newton's method with a line search stalls where the residual has to rise before it falls; the path goes on. Next to a
solution it has few corners, but thousands may lie between two solutions.

The balance is linear in its loads, too, which may grow along with s. From the solution under a small load, all that is
left of the residual is rounding, and the path passes through solutions only.

Sources: Fujisawa & Kuh (1970), Piecewise-linear theory of nonlinear networks, memorandum ERL-M286, Berkeley;
Ralph (1994), doi:10.1287/moor.19.2.352.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.balance.law_derivatives import Derivative
from ewr_fenicsx.balance.newton_step import Factorisation, NewtonStep
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.laws.law_kinds import Law, Motion, Response
from ewr_fenicsx.solver.snes import Attempt, LinearSolver, run_newton

RANK = 250  # corners after which the Jacobian is factored anew: by then they cost as much as that, or more
SHORT = 100  # corners of a path at most that is tried on the way to a better start
CORNERS, WORK = 2500, 10**6  # of a path at most, and times the unknowns: some seconds
TRIED = 500  # corners after which a path is left that is not on its way: those that arrive mostly lie evenly on theirs
# The same of a path from far off: it may be longer, as long as it is on its way, and looks for it longer.
FAR_CORNERS, FAR_WORK, FAR_TRIED = 12000, 2 * 10**7, 1000
LARGEST_FAR = 2000  # unknowns above which such a path takes too long, unless it begins next to a solution
LAST_STEPS = 5  # Newton steps at the end of a path, which take away what rounding has left
BEHIND, LOST = -1.0, 1e4  # where a path is left: its parameter, and the norm of the unknowns, which are of order one
# Rate at which a corner is approached, over the largest one, below which it is not: rounding, as of pairs that are open
IDLE = 1e-10
# Error of a solution with updates of rank one up to which it is refined; with more, their inverse is made anew
NEARLY = 1e-9
CLOSE = 1e-3  # residual where Newton's method stalls, below which a solution is close
SINGULAR = "the Newton matrix is singular"  # why a path ends
ARRIVED = "rounding is left at the end of Newton's path"


def run_and_follow(
    balance: HarmonicBalance,
    start: RealArray,
    tolerance: float,
    linear_solver: LinearSolver,
    limit: int | None,
    *,
    near: bool = False,
    most: int | None = None,
) -> Attempt:
    """Newton's method as ``run_newton``, and where it stalls next to a solution, its path from there.

    ``most``: corners of that path at most; None: as many as are worth the time.
    """
    run = run_newton(balance, start, tolerance, linear_solver, limit, near=near)
    if run.decides or not run.residual < CLOSE:
        return run
    path = follow_path(balance, run.unknowns, tolerance, most or limit_corners(balance))
    if path is None:
        return run
    return replace(min(path, run), iterations=run.iterations + path.iterations)


def follow_path(
    balance: HarmonicBalance,
    start: RealArray,
    tolerance: float,
    most: int,
    loaded_less: HarmonicBalance | None = None,
    tried: int = TRIED,
) -> Attempt | None:
    """Follow Newton's path from a start; each factorisation counts as a Newton step, and serves ``RANK`` corners.

    Args:
        balance: The balance.
        start: ``(size,)`` scaled unknowns.
        tolerance: Residual norm accepted.
        most: Corners at most.
        loaded_less: The same under other loads, near whose solution it starts: on the way these grow to the balance's.
        tried: Corners that it may take before it has to be on its way to arrive in ``most``, or in ``CORNERS``.

    Returns:
        The solution, or how far the path went; None where some law does not tell its corners.
    """
    if not can_follow(balance):
        return None
    path = _Path(balance, start, loaded_less or balance)
    try:
        why = path.follow(tolerance, most, tried)
    except np.linalg.LinAlgError:
        why = SINGULAR
    last = LAST_STEPS if why == ARRIVED else 0
    found = run_newton(balance, path.unknowns, tolerance, "elimination", last, near=True)  # looks whether it walks
    reason = found.reason if found.decides else why
    return replace(found, iterations=path.factored + found.iterations, reason=reason)


def follow_from_afar(balance: HarmonicBalance, start: RealArray, tolerance: float) -> Attempt | None:
    """Follow Newton's path from a start that need not be near a solution, as long as it is on its way.

    Most such paths are not, and are left after a few factorisations.

    Returns:
        The solution, or how far the path went; None where some law does not tell its corners, where the balance is so
        large that no path is followed from there, or where the start is nowhere.
    """
    if not np.linalg.norm(start) < LOST:
        return None
    if balance.size > LARGEST_FAR and not balance.measure_residual(start) < CLOSE:
        return None
    return follow_path(balance, start, tolerance, limit_corners(balance, FAR_CORNERS, FAR_WORK), tried=FAR_TRIED)


def can_follow(balance: HarmonicBalance) -> bool:
    """Whether every law tells its corners, or has none."""
    return all(law.linear or law.has_corners for law in balance.system.laws)


def limit_corners(balance: HarmonicBalance, corners: int = CORNERS, work: int = WORK) -> int:
    """How many corners of a path are worth the time that they take: at most, and times the unknowns."""
    return min(corners, work // balance.size)


class RankOneUpdates:
    """A factored matrix J and what is added to it, ``sum u w^T``; ``RANK`` products at most."""

    def __init__(self, factors: Factorisation):
        size = factors.solution.size
        self.factors, self.count = factors, 0
        self.moved, self.seen = np.zeros((2, RANK, size))  # J^-1 u, and w
        self.small, self.inverse = np.zeros((2, RANK, RANK))  # 1 + W^T J^-1 U, and its inverse, nearly

    def add(self, u: RealArray, w: RealArray) -> tuple[RealArray, float]:
        """Add ``u w^T``; ``u`` solved for with the matrix of before, and the determinant over that of before."""
        k, column = self.count, self.factors.solve(u)
        self.moved[k], self.seen[k] = column, w
        self.small[:k, k], self.small[k, : k + 1] = self.seen[:k] @ column, self.moved[: k + 1] @ w
        self.small[k, k] += 1.0
        shares = self._solve(self.small[:k, k])
        column = column - shares @ self.moved[:k]
        ratio = float(1.0 + w @ column)
        inverse = self.inverse[:k, :k]
        across = self.small[k, :k] @ inverse
        with np.errstate(divide="ignore", invalid="ignore"):  # whoever asks looks at the ratio
            inverse += np.divide(np.outer(shares, across), ratio)
            self.inverse[k, :k], self.inverse[:k, k] = np.divide(-across, ratio), np.divide(-shares, ratio)
            self.inverse[k, k] = np.divide(1.0, ratio)
        self.count += 1
        return column, ratio

    def _solve(self, right: RealArray) -> RealArray:
        """The small matrix solved with: its inverse is bordered, and made anew where rounding has added up in it."""
        k = self.count
        small, inverse = self.small[:k, :k], self.inverse[:k, :k]
        solution = inverse @ right
        left = right - small @ solution
        if not np.linalg.norm(left) <= NEARLY * np.linalg.norm(right):
            inverse[:] = np.linalg.inv(small)
            solution = inverse @ right
            left = right - small @ solution
        return solution + inverse @ left


class _Path:
    """A point on Newton's path, and the side of every corner on which it lies."""

    def __init__(self, balance: HarmonicBalance, start: RealArray, loaded_less: HarmonicBalance):
        self.balance, self.unknowns = balance, start.copy()
        self.begin = loaded_less.residual(start)
        self.growing = balance.compliance.free_motion - loaded_less.compliance.free_motion
        self.grows = bool(np.any(self.growing))
        self.share, self.factored, self.crossed = 0.0, 0, 0
        self.still = self._look(np.zeros_like(start), balance.compliance.free_motion)
        self.sides = [corners > 0 for corners in self._look_here()]

    def follow(self, tolerance: float, most: int, tried: int = TRIED) -> str:
        """Go on until the residual is small enough, or the path is left; says why it ended.

        Raises:
            numpy.linalg.LinAlgError: A Newton matrix on the way is singular.
        """
        sense, left = 1.0, np.inf if self.grows else float(np.linalg.norm(self.begin))
        while True:
            step = NewtonStep(self.balance, self._differentiate(), self.begin)
            updates = RankOneUpdates(Factorisation(step, self.begin + self._find_pull(step)))
            self.factored += 1
            drift = updates.factors.solve(self._find_drift())
            if not np.linalg.norm(drift) < np.inf:
                return SINGULAR
            self.unknowns -= drift
            ahead, at = -sense * updates.factors.solution, self._look_here()
            while updates.count < RANK:
                if not np.linalg.norm(ahead) < np.inf:
                    return SINGULAR
                rates = self._find_rates(ahead, sense)
                reach, number, corner = self._find_corner(at, rates)
                arrives = sense > 0 and reach >= 1 - self.share
                reach = 1 - self.share if arrives else reach
                unknowns = self.unknowns + (reach * ahead if reach < np.inf else np.inf)
                if not np.linalg.norm(unknowns) < LOST:
                    return "Newton's path runs to infinity"
                self.unknowns, self.share = unknowns, self.share + sense * reach
                for corners, rate in zip(at, rates, strict=True):
                    corners += reach * rate
                if arrives or abs(1 - self.share) * left <= 0.5 * tolerance:
                    return ARRIVED
                if self.share < BEHIND:
                    return "Newton's path leads away"
                self.crossed += 1
                if self.crossed >= min(most, max(tried, max(most, CORNERS) * self.share)):
                    what = "load" if self.grows else "residual"
                    return f"Newton's path takes {self.share:.0%} of the {what} in {self.crossed} corners"
                change = self._cross(number, corner)
                if change is None:
                    continue
                u, w, pull = change
                moved, ratio = updates.add(u, w)
                with np.errstate(divide="ignore", invalid="ignore"):
                    ahead = ahead - np.divide(w @ ahead + sense * pull, ratio) * moved
                if ratio < 0:
                    sense, ahead = -sense, -ahead

    def _find_pull(self, step: NewtonStep) -> RealArray:
        """How fast the residual changes with the growing loads, ``(size,)``."""
        return step.change(np.zeros_like(self.growing), self.growing)

    def _find_drift(self) -> RealArray:
        """What rounding has made of the residual on the path, ``(size,)``."""
        motion = self.balance.compliance.motion(*self.balance.unpack(self.unknowns)) - self._lacking
        return self.balance.residual(self.unknowns, motion) - (1 - self.share) * self.begin

    @property
    def _lacking(self) -> ComplexArray:
        """Motion by the share of the growing loads that has not come yet, amplitudes ``(n_h, m)`` [m]."""
        return (1 - self.share) * self.growing

    def _look_here(self) -> list[RealArray]:
        """Corner functions of every law at the point, ``(n, n_t, K)``."""
        return self._look(self.unknowns, self._lacking)

    def _look(self, unknowns: RealArray, lacking: ComplexArray) -> list[RealArray]:
        """The same elsewhere, where so much of the motion by loads is lacking, amplitudes ``(n_h, m)`` [m]."""
        balance = self.balance
        forces, rigid = balance.unpack(unknowns)
        seen = balance.sample(forces, balance.compliance.motion(forces, rigid) - lacking)
        return [
            np.zeros(0) if law.linear else self._ask(law, at) for law, at in zip(balance.system.laws, seen, strict=True)
        ]

    def _ask(self, law: Law, motion: Motion) -> RealArray:
        """A law's corner functions, ``(n, n_t, K)``."""
        corners, shape = law.find_corners(motion), (self.balance.basis.samples, law.pairs.size)
        if wrong := [np.shape(one) for one in corners if np.shape(one) != shape]:
            raise ModelError(
                f"{type(law).__name__}.find_corners returns an array of shape {wrong[0]}; give some of {shape}, "
                "instants by pairs"
            )
        return np.array(corners)

    def _find_rates(self, ahead: RealArray, sense: float) -> list[RealArray]:
        """How fast corner functions change along a direction, in which the share grows, or falls."""
        size = np.linalg.norm(ahead) or 1.0
        moved = self._look(ahead / size, self.balance.compliance.free_motion - sense / size * self.growing)
        return [size * (there - here) for there, here in zip(moved, self.still, strict=True)]

    def _find_corner(self, at: Sequence[RealArray], rates: Sequence[RealArray]) -> tuple[float, int, tuple[int, ...]]:
        """How far the next corner is, the number of its law, and its place there."""
        idle = IDLE * max(np.abs(rate).max(initial=0.0) for rate in rates)
        nearest, number, corner = np.inf, 0, ()
        for i, (corners, rate, side) in enumerate(zip(at, rates, self.sides, strict=True)):
            toward = np.where(side, -rate, rate)
            near = toward > idle
            if not np.any(near):
                continue
            reach = np.full(rate.shape, np.inf)
            np.divide(np.where(side, corners, -corners), toward, out=reach, where=near)
            first = int(np.argmin(reach))
            if reach.flat[first] < nearest:
                nearest, number, corner = float(reach.flat[first]), i, np.unravel_index(first, reach.shape)
        return max(0.0, nearest), number, corner

    def _differentiate(self) -> tuple[Derivative, ...]:
        """Derivatives of all laws on this piece."""
        balance = self.balance
        seen = balance.sample(*np.zeros((2, len(balance.basis.orders), balance.rows), dtype=complex))
        return balance.differentiate(
            [
                law.evaluate(at) if law.linear else Response(np.zeros(0), law.differentiate(sides))
                for law, at, sides in zip(balance.system.laws, seen, self.sides, strict=True)
            ]
        )

    def _cross(self, number: int, corner: tuple[int, ...]) -> tuple[RealArray, RealArray, float] | None:
        """Go to the other side; the change of the Jacobian as ``u`` and ``w``, ``(size,)``; None: there is none.

        And what growing loads pull along ``u`` beside it.
        """
        balance, (_, sample, pair) = self.balance, corner
        law, row = balance.system.laws[number], balance.law_rows[number][pair]
        sides = self.sides[number][:, sample : sample + 1]
        before = law.differentiate(sides)
        self.sides[number][corner] ^= True
        by_forces, by_rigid, pull, changes = np.zeros(balance.unknown.shape), np.zeros(balance.rigid), 0.0, False
        for old, new in zip(before, law.differentiate(sides), strict=True):
            column = balance.system.row_of(new.direction, law.pairs[pair : pair + 1])
            value = new.values[:1, pair] - old.values[:1, pair]
            if value != 0 and column[0] >= 0:  # else it is given, not unknown
                forces, rigid, load = self._read(
                    sample, Derivative(np.array([row]), column, new.variable, value[:, None])
                )
                by_forces, by_rigid, pull, changes = by_forces + forces, by_rigid + rigid, pull + load, True
        if not changes:
            return None
        moved = np.zeros(balance.unknown.shape)
        moved[:, row] = balance.basis.analysis[:, sample]
        if balance.basis.has_mean:
            moved[0, row] *= balance.static_row[row]
        return (
            np.concatenate([moved[balance.unknown], np.zeros(balance.rigid)]),
            np.concatenate([by_forces[balance.unknown], by_rigid]),
            pull,
        )

    def _read(self, sample: int, d: Derivative) -> tuple[RealArray, RealArray, float]:
        """A derivative times its variable at a sample, by all forces ``(n_c, m)``, rigid coordinates ``(r,)``, and the
        share of growing loads.
        """
        balance, basis, column, value = self.balance, self.balance.basis, d.columns[0], d.values[0, 0]
        factor = value * np.exp(2j * np.pi * sample / basis.samples * np.array(basis.orders)) * balance.rate**d.rates
        if d.blind_to_mean and basis.has_mean:
            factor[0] = 0.0
        amplitudes: ComplexArray = np.zeros((factor.size, balance.rows), dtype=complex)
        rigid, load = np.zeros(balance.rigid), 0.0
        if d.by_force:
            amplitudes[:, column] = factor
        else:
            amplitudes += factor[:, None] * balance.compliance.flexibility[:, column]
            load = float(np.real(factor @ self.growing[:, column])) / balance.force_unit
            if not d.blind_to_mean:
                rigid = value * balance.rigid_motion[column]
        return basis.to_coefficients(amplitudes.conj()), rigid, load
