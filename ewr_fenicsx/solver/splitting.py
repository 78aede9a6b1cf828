"""Operator splitting: where Newton's method starts from cold, found by asking structure and laws in turn.

Contact forces obey two conditions. The *structure* answers them with a motion, harmonic by harmonic. The *laws* admit,
sample by sample, the force nearest to itself less a multiple of that motion. Each by itself is cheap to obey, and
Douglas-Rachford splitting brings them together. With a ``scale``, force over motion row by row:

    x  with  x + scale * motion(x) = state       what the structure makes of a state
    f = admit(2 x - state)                       what the laws make of that
    state += f - x

Where both agree, ``x = admit(x - scale * motion(x))``: the laws hold. A structure takes energy at every harmonic. So
under given normal forces friction is a monotone problem, and the iteration converges from anywhere, at a resonance as
elsewhere. Contact that opens on bodies driven above their modes is not monotone, and there it may end nowhere. With
Anderson's extrapolation a hundred iterations cost as much as a few Newton steps; a Newton matrix is never formed.

The admissible forces' harmonics that the balance leaves out are closed as there, by the laws' own ``impedance``, that
of dashpots or springs: what the iteration tends to is the balance's solution, but for the samples a period, of which
fewer will do. Masses that close a truncation have none: dashpots of the scale take their place, and what comes out is
near only.

Sources: Lions & Mercier (1979), doi:10.1137/0716071; Walker & Ni (2011), doi:10.1137/10078356X.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import scipy.fft
import scipy.signal

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.laws.law_kinds import Law, Signal
from ewr_fenicsx.problem.harmonics import FourierBasis, round_up, sample_amplitudes

# Scale of a row: this over its own flexibility, for velocities also over omega and the root of the number of such rows,
# as pairs that slip move each other. A few times either way cost some iterations.
SCALE = {"displacement": 3.0, "velocity": 1.0}
# Bodies above their modes move against forces. At a harmonic where some move by about minus the force over the scale,
# the structure's answer grows large and the iteration diverges. How many times larger scales are tried for rows that
# oppose displacements, and the growth of an answer from which on they are.
FIRMNESSES, MOST_GROWTH = (1.0, 3.0, 10.0), 5.0
# Many pairs that mostly stick move each other less than that: where a splitting comes no nearer, larger scales of rows
# that oppose velocities lead on, and the balance is nearer to zero where they end. How many times larger, from one to
# the next and in the end, and over a defect the residual from which on.
STIFFER, STIFFEST, APART = 10.0, 100.0, 10.0
BLOCK = 8  # harmonics whose answers are found at once, after which growth is looked at
SAMPLES, FEWEST_SAMPLES = 6, 64  # a highest harmonic, up to a power of two as in a balance; and at least
PROGRESS, ROUNDING = 0.7, 1e-10  # share of itself to which a defect must fall in time; rounding in the extrapolation
# Unknowns from which on a splitting is worth its while: in small joints Newton steps cost no more than its iterations.
WORTHWHILE = 200
TOLERANCE = 1e-3  # defect at which Newton's method takes over;
DEAR_FROM, DEAR_TOLERANCE = 2000, 1e-4  # a lower one from so many unknowns on, where its steps are dear
NEAR_ENOUGH = 2.0  # times that defect, from which it may still arrive
# How often Newton's method may begin from a splitting, and the share of its defect that is left from one to the next
LOOKS, NEARER = 3, 0.1
# Over the unit of force: the least forces beside which a defect is measured, and the largest state that leads anywhere.
LEAST, LOST = 1e-4, 1e6


class Effort(NamedTuple):
    """How far a splitting goes."""

    iterations: int  # at most
    patience: int  # iterations in which the defect must fall to ``PROGRESS`` of itself
    window: int  # iterations that the extrapolation looks back on


QUICK = Effort(400, 100, 10)
# Below this defect an extrapolation may look back further: far off, states of long ago mislead it.
ROUGH, CLOSE = 1e-2, QUICK._replace(window=20)


class Split(NamedTuple):
    """Where a splitting ended: the best state ``(n_t, m)``, its defect over the forces, and the iterations."""

    state: RealArray
    defect: float
    iterations: int


def can_split(balance: HarmonicBalance) -> bool:
    """Whether a splitting is worth its while, and all laws are projections."""
    return balance.size >= WORTHWHILE and are_projections(balance)


def are_projections(balance: HarmonicBalance) -> bool:
    """Whether all laws of a balance are projections."""
    return all(law.opposes for law in balance.system.laws)


class Splitting:
    """The two conditions of a balance, each by itself; a state is ``(n_t, m)`` samples over a period [N].

    Args:
        balance: A balance all of whose laws are projections.
        samples: A period, more than twice the highest harmonic; None: as many as the harmonics need.
        softness: Share of its usual scale that a row takes whose law opposes displacements.
        stiffness: Times its usual scale that a row takes whose law opposes velocities.
        springs: Whether springs close truncations where laws have them, or dashpots of the scale.

    Attributes:
        scale: ``(m,)`` force over the motion that each row's law opposes.
        impedance: ``(m,)`` of what closes each row's truncation as in the balance; NaN where nothing does.
        ratio: ``(m,)`` the scale over that; one where there is none.
        opposed: ``(n_h, m)`` motion that is opposed over displacement [1/s], or 1.
        share: ``(n_f, m)`` of each harmonic of a state that the samples tell, were it left out: the force's.

    Raises:
        numpy.linalg.LinAlgError: The structure has no answer.
    """

    def __init__(
        self,
        balance: HarmonicBalance,
        samples: int | None = None,
        softness: float = 1.0,
        *,
        stiffness: float = 1.0,
        springs: bool = True,
    ):
        self.balance = balance
        orders, omega = balance.basis.orders, balance.compliance.omega or 1.0
        told = 2 * balance.system.highest_given + 1
        enough = max(FEWEST_SAMPLES, round_up(max(SAMPLES * orders[-1], told)))
        self.basis = FourierBasis(orders, max(told, samples or enough) if orders[-1] else 1)
        self.orders = np.array(orders)
        self.kept = _join_up(self.orders)
        self.halves = np.where(self.orders == 0, 1.0, 0.5)[:, None]  # of an amplitude, in a spectrum
        self.by_rate, self.offset = np.zeros(balance.rows, dtype=bool), np.zeros(balance.rows)
        self.sprung, usual = np.zeros(balance.rows, dtype=bool), np.ones(balance.rows)
        self.impedance = np.full(balance.rows, np.nan)
        for law, rows in zip(balance.system.laws, balance.law_rows, strict=True):
            self.by_rate[rows] = rate = law.opposes == "velocity"
            by_springs = law.closes == "springs"
            if law.impedance is not None and (springs or not by_springs):
                self.impedance[rows], self.sprung[rows] = law.impedance, by_springs and rate
            usual[rows] = SCALE[law.opposes] / balance.system.flexibility[rows]
            if not rate and law.static_target is not None:
                self.offset[rows] = -law.static_target
        usual[~self.by_rate] *= softness
        usual[self.by_rate] *= stiffness / (omega * np.sqrt(max(1, np.count_nonzero(self.by_rate))))
        self.opposed = np.where(self.by_rate, balance.rate[:, None], 1.0)
        self.opposed[:, self.sprung] = self._differ(self.orders)
        self.sought = np.ones(self.opposed.shape, dtype=bool)  # a mean that is set to zero is not
        if balance.basis.has_mean:
            self.sought[0] = balance.unknown[0]
        self.admit = [self._make_admit(*owner) for owner in zip(balance.system.laws, balance.law_rows, strict=True)]
        for firmness in FIRMNESSES:
            if self._weigh(np.where(self.by_rate, usual, firmness * usual), MOST_GROWTH):
                break
        else:
            self._weigh(usual)
        self._invert_mean()

    def _differ(self, orders: np.ndarray) -> ComplexArray:
        """Rates of change from sample to sample [1/s] at harmonics ``(n,)``, as a column: so springs see them."""
        step = 2 * np.pi / self.basis.samples
        return (self.balance.compliance.omega * (1 - np.exp(-1j * step * orders)) / step)[:, None]

    def _make_admit(self, law: Law, rows: np.ndarray) -> Callable[[RealArray, ComplexArray, RealArray], None]:
        """Writes what a law admits: it sees trial forces of its own side, and the truncated ones of the other."""
        columns = {d: _join_up(at) for d, at in self.balance.system.rows_of(law.pairs).items()}
        own = {d: at for d, at in columns.items() if (d == "normal") == (law.direction == "normal")}
        other = {d: at for d, at in columns.items() if d not in own}
        given, place, wanted = {}, _join_up(rows), (self.basis.samples, rows.size)
        if "normal" not in columns:
            normal = sample_amplitudes(self.balance.system.prescribed, law.pairs, self.basis.samples)
            given["normal"] = lambda: normal

        def admit(trial: RealArray, truncated: ComplexArray, admissible: RealArray) -> None:
            across = {d: lambda at=at: self._sample(truncated[:, at]) for d, at in other.items()}
            found = law.admit(Signal(lambda: trial, own, given | across))
            if np.shape(found) != wanted:
                raise ModelError(
                    f"{type(law).__name__}.admit returns an array of shape {np.shape(found)}; give one of {wanted}, "
                    "instants by pairs"
                )
            admissible[:, place] = found

        return admit

    def _weigh(self, scale: RealArray, most: float = np.inf) -> bool:
        """Sets the scale, ``(m,)``, and finds the structure's answers with it; False where one grows above ``most``."""
        self.scale = scale
        self.ratio = np.where(np.isnan(self.impedance), 1.0, scale / self.impedance)
        harmonics = np.arange(self.basis.samples // 2 + 1)
        self.share = 1 / (1 + self.ratio * np.where(self.sprung, self._differ(harmonics), 1.0))
        return self._invert(most)

    def _invert(self, most: float) -> bool:
        """Finds ``x`` as ``inverse @ state + unforced`` for all harmonics but the mean, until an answer grows too much.

        ``growth`` is how many times its size a part of the state grows where the structure reflects it: a cheap guess
        at the reflection's largest singular value, the sum of their squares were all others 1. Answers that grow are
        those of high harmonics, which come first.
        """
        compliance, identity = self.balance.compliance, np.eye(self.balance.rows)
        weight, self.growth = self.opposed * self.scale, 0.0
        self.inverse, self.unforced = np.zeros_like(compliance.flexibility), np.zeros_like(weight)
        oscillate = np.flatnonzero(self.orders)[::-1]
        for at in np.split(oscillate, range(BLOCK, oscillate.size, BLOCK)):
            self.inverse[at] = np.linalg.inv(weight[at, :, None] * compliance.flexibility[at] + identity)
            self.unforced[at] = -np.matmul(self.inverse[at], (weight * compliance.free_motion)[at, :, None])[:, :, 0]
            reflected = np.linalg.norm(2.0 * self.inverse[at] - identity, axis=(1, 2)).max(initial=0.0)
            self.growth = max(self.growth, float(np.sqrt(max(0.0, reflected**2 - (self.balance.rows - 1)))))
            if self.growth > most:
                return False
        return True

    def _invert_mean(self) -> None:
        """The same for the mean, with rigid coordinates.

        Friction sees what the balance adds to its mean equation: part of the force that laws admit, but none of what
        moves the structure. ``added`` is the share of a state, less the force that moves it, which that part is.
        """
        self.rigid_inverse = np.zeros((self.balance.rigid, self.balance.rows))
        self.rigid_unforced = np.zeros(self.balance.rigid)
        if not self.balance.basis.has_mean:
            return
        balance, compliance, known = self.balance, self.balance.compliance, self.sought[0]
        seen = 1.0 + np.where(self.sprung, 1.0, self.ratio)
        self.added = np.where(self.by_rate, 1.0 / seen, 0.0)
        share = np.where(self.by_rate, seen * balance.firm.static_force_row, 0.0)
        stiffness = np.where(self.by_rate, seen * balance.firm.static_displacement_row, self.scale)
        matrix = np.diag(1.0 + share) + stiffness[:, None] * compliance.flexibility[0].real
        moved = -stiffness * (compliance.free_motion[0].real + np.where(self.by_rate, 0.0, self.offset))
        turned, held = stiffness[:, None] * balance.rigid_motion, compliance.rigid_motion.T
        saddle = np.block(
            [[matrix[np.ix_(known, known)], turned[known]], [held[:, known], np.zeros((balance.rigid,) * 2)]]
        )
        inverse = np.linalg.inv(saddle)
        unforced = inverse @ np.concatenate([moved[known], -compliance.rigid_load])
        forces, rigid = np.split(np.arange(len(saddle)), [np.count_nonzero(known)])
        self.inverse[0][np.ix_(known, known)], self.unforced[0, known] = (
            inverse[np.ix_(forces, forces)],
            unforced[forces],
        )
        self.rigid_inverse[:, known], self.rigid_unforced = inverse[np.ix_(rigid, forces)], unforced[rigid]

    def _analyse(self, state: RealArray) -> ComplexArray:
        """The harmonics that samples ``(n_t, m)`` tell, ``(n_f, m)``: of each but the mean half the amplitude."""
        return scipy.fft.rfft(state, axis=0, norm="forward")

    def _sample(self, spectrum: ComplexArray) -> RealArray:
        """Samples ``(n_t, m)`` of what ``_analyse`` makes of them."""
        return scipy.fft.irfft(spectrum, self.basis.samples, axis=0, norm="forward")

    def respond(self, spectrum: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """The harmonics sought of a state's, and the forces that the structure makes of them, ``(n_h, m)``."""
        harmonics = np.where(self.sought, spectrum[self.kept] / self.halves, 0.0)
        return harmonics, np.matmul(self.inverse, harmonics[:, :, None])[:, :, 0] + self.unforced

    def compare(self, state: RealArray) -> tuple[RealArray, RealArray]:
        """Forces of the structure, and what the laws admit of them, ``(n_t, m)`` each."""
        spectrum = self._analyse(state)
        whole, truncated = self.share * spectrum, np.zeros_like(spectrum)
        truncated[self.kept] = self.halves * self.respond(spectrum)[1]
        whole[self.kept] = np.where(self.sought, truncated[self.kept], whole[self.kept])
        if self.balance.basis.has_mean:
            whole[0] += np.where(self.sought[0], self.added * (spectrum[0] - truncated[0]), 0.0)
        forces = self._sample(whole)
        trial, admissible = 2 * forces - state, np.empty_like(state)
        trial.flags.writeable = False  # laws see parts of it, no copies
        for admit in self.admit:
            admit(trial, truncated, admissible)
        return forces, admissible

    def unknowns(self, state: RealArray) -> RealArray:
        """The balance's unknowns at a state."""
        harmonics, kept = self.respond(self._analyse(state))
        rigid = self.rigid_unforced
        if rigid.size:
            rigid = (self.rigid_inverse @ harmonics[0].real + rigid) * self.balance.mean_flexibility
        return self.balance.pack(kept, rigid)

    def begin(self) -> RealArray:
        """The state of full stick, where forces cause no motion; pairs with wide gaps are apart."""
        return self.basis.synthesise(self.balance.cold_start[0]) + self.scale * self.balance.wide_gaps

    def join(self, forces: ComplexArray, motion: ComplexArray) -> RealArray:
        """The state of forces [N] and motions [m] of all rows, ``(n_h, m)``, which need not fit each other."""
        return self.basis.synthesise(forces + self.scale * self.opposed * motion) + self.scale * self.offset

    def take_over(self, other: Splitting, state: RealArray) -> RealArray:
        """The state of the same forces and motions that ``other``, of other scales, has in a state ``(n_t, m)``."""
        forces, _ = other.compare(state)
        return forces + self.scale / other.scale * (state - forces)


def _join_up(places: np.ndarray) -> np.ndarray | slice:
    """Places as a slice where one follows the other, which is read without a copy."""
    follows = places.size and np.array_equal(places, places[0] + np.arange(places.size))
    return slice(int(places[0]), int(places[-1]) + 1) if follows else places


def resample(state: RealArray, splitting: Splitting) -> RealArray:
    """A state of other harmonics with the samples of a splitting."""
    return scipy.signal.resample(state, splitting.basis.samples)


def come_near(
    balance: HarmonicBalance, begin: Callable[[Splitting], RealArray]
) -> Iterator[tuple[RealArray, RealArray]]:
    """State and unknowns near a solution, ever nearer, as far as a splitting begun in the state of ``begin`` leads."""
    dear = balance.size >= DEAR_FROM
    goal, stiffness = DEAR_TOLERANCE if dear else TOLERANCE, 1.0
    try:
        splitting = Splitting(balance)
        found = settle(splitting, begin(splitting), ROUGH)
        springs = found.defect <= ROUGH or not np.any(splitting.sprung)
        if not springs:  # dashpots lead on in hard cases, if less far
            splitting = Splitting(balance, springs=False)
            found = settle(splitting, begin(splitting), ROUGH)
        if found.defect > ROUGH:
            return
        for _ in range(LOOKS):
            found = settle(splitting, found.state, goal, CLOSE)
            while dear and stiffness < STIFFEST and _is_far(splitting, found, goal):
                stiffness *= STIFFER
                stiffer = Splitting(balance, stiffness=stiffness, springs=springs)
                splitting, state = stiffer, stiffer.take_over(splitting, found.state)
                found = settle(splitting, state, goal, CLOSE)
            if found.defect >= NEAR_ENOUGH * goal:
                return
            yield found.state, splitting.unknowns(found.state)
            goal *= NEARER
    except np.linalg.LinAlgError:  # as next to a mode without damping
        return


def _is_far(splitting: Splitting, found: Split, goal: float) -> bool:
    """Whether a splitting came no nearer than that, or the balance is much further from zero than it tells."""
    firm = splitting.balance.firm
    far = found.defect >= NEAR_ENOUGH * goal
    return far or firm.measure_residual(splitting.unknowns(found.state)) > APART * found.defect


def settle(splitting: Splitting, state: RealArray, tolerance: float, effort: Effort = QUICK) -> Split:
    """Iterates until the defect, over the forces or the unit of force where that is less, is at most a tolerance.

    Stops where it falls no further, too. The unit may be far above the forces: at a resonance, or where gaps are wide.
    Anderson's extrapolation combines the last iterations so that the defect would be least, were it linear.
    """
    unit = splitting.balance.force_unit * np.sqrt(len(state) / 2)
    window = effort.window
    advances, changes = np.empty((2, window, state.size))  # moves with their changes, and changes of the defect
    products, overlap = np.empty((window, window)), np.zeros(window)  # with one another, and with the defect
    best, lowest, last, before = Split(state, np.inf, 0), np.inf, 0, None
    for k in range(effort.iterations):
        if not np.linalg.norm(state) < LOST * unit:
            break
        forces, admissible = splitting.compare(state)
        defect = admissible - forces
        size = float(np.linalg.norm(defect) / min(max(np.linalg.norm(forces), LEAST * unit), unit))
        if size < best.defect:
            best = Split(state, size, k + 1)
        if size < PROGRESS * lowest:
            lowest, last = size, k
        if not size > tolerance or k - last > effort.patience:
            break
        state = after = state + defect
        if before is not None:
            i, known = (k - 1) % window, min(k, window)
            np.subtract(defect, before[1], out=changes[i].reshape(defect.shape))
            np.subtract(after, before[0], out=advances[i].reshape(after.shape))
            products[i, :known] = products[:known, i] = changes[:known] @ changes[i]
            overlap[:known] += products[i, :known]
            overlap[i] = changes[i] @ defect.ravel()
            normal = products[:known, :known]
            normal = normal + ROUNDING * np.trace(normal) * np.eye(known)
            shares = np.linalg.solve(normal, overlap[:known])
            state = after - (shares @ advances[:known]).reshape(after.shape)
        before = after, defect
    return best._replace(iterations=k + 1)
