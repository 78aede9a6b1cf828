"""A periodic solution: a periodic motion, how it was found, how good it is, and whether motions in time stay at it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ewr_fenicsx.balance.periodic_motion import SECOND, PeriodicMotion
from ewr_fenicsx.in_time.floquet import find_growth, grows, list_unfollowed, settles, tell_where_to
from ewr_fenicsx.in_time.ring_growth import RingGrowth, find_ring_growth, leaves
from ewr_fenicsx.in_time.stability import alternates, find_side
from ewr_fenicsx.in_time.walking import Walk, measure_walk, watch_walk
from ewr_fenicsx.problem.dashpots import weigh_lighter
from ewr_fenicsx.problem.harmonics import FourierBasis
from ewr_fenicsx.problem.ignored import list_ignored
from ewr_fenicsx.solution import indicators
from ewr_fenicsx.solution.loading_history import tell_history, tell_missed_mean
from ewr_fenicsx.solution.unpressed import tell_unpressed

FINE = 1024  # samples a period, at least, on which violations of the laws are looked for
COARSE_ENERGY, COARSE_TENSION = 0.01, 0.1  # imbalance, and tension over the largest force, that are worth a word
SETTLING, SETTLED = 8, 1e-8  # Newton steps to a solution next to this one, and their residual over its forces
MISSED = 0.05  # share of the oscillating contact forces, at a harmonic that is not kept, that is worth a word
FEW_MULTIPLES = 3  # of the loads' harmonics: with fewer, friction and taps are hardly seen
FEW_SAMPLES = 4  # a highest harmonic: up to so many, what a law makes of two harmonics kept folds back on others
HIT = 1e-9  # dynamic over static stiffness that is left of a mode without damping where it is hit
TINY = np.finfo(float).tiny
LISTED = 8  # harmonics that are named one by one; of more, the first three and the last
LITTLE_EXCHANGE = 1e-6  # energy lost over that swinging to and fro, below which any gain is rounding or truncation


@dataclass(frozen=True, eq=False, repr=False)
class PeriodicSolution(PeriodicMotion):
    """Result of ``solve``; the histories and figures of merit are computed when asked for.

    Attributes:
        problem: What was solved.
        forces: ``(n_h, m)`` complex amplitudes of the unknown contact forces, rows as in ``problem.system`` [N].
        rigid: ``(r,)`` mean rigid coordinates of floating bodies [m].
        converged: Whether the residual met the tolerance.
        reason: Why the solve stopped.
        iterations: Newton steps, fallbacks included.
        fallbacks: Every rung of the ladder that was taken, in order; empty where the first attempt converged.
        residual: Norm of the weighted residual over the natural force.
        seconds: Wall time of the solve.
        unknowns: Number of unknowns given to Newton; 0 where every pair is bonded or free.
        stages: Wall time of the solve by stage [s].
        left_out: Harmonics at which the contact forces are zero by symmetry, so that the solve did without.
        why_left_out: By which symmetry.
        estimated_error: Of the outputs, relative, where an accuracy was asked of ``solve``; NaN: nobody looked.
        short: Why it is not as accurate as asked, and what to do; "" where it is, or where nothing was asked.
        tell_error: What its summary says of its error, asked for then, since that takes as long as some Newton steps.
    """

    converged: bool
    reason: str
    iterations: int
    fallbacks: tuple[str, ...]
    residual: float
    seconds: float
    unknowns: int
    stages: Mapping[str, float] = field(default_factory=dict)
    left_out: tuple[int, ...] = ()
    why_left_out: str = ""
    estimated_error: float = np.nan
    short: str = ""
    tell_error: Callable[[PeriodicSolution], str] | None = None

    def __repr__(self) -> str:
        where = f"{self.problem.frequency:g} Hz, {self.problem.model.pairs} pairs, harmonics up to {self.orders[-1]}"
        return f"PeriodicSolution({where}, {self.iterations} Newton steps: {self.reason})"

    @cached_property
    def merit(self) -> dict[str, float]:
        """Figures of merit by name; docs/method.md defines each.

        Violations of the laws [m, N, over the largest limit], looked for between the samples as well, where no law is
        enforced; energies over a period [J] and their imbalance [-]; sliding a cycle, a mean over the pairs, and mean
        gap, over those that may part [m]; RMS of outputs in their own units.
        """
        problem, model, count = self.problem, self.problem.model, self.problem.basis.samples
        viscous = self._rate * model.react("damping", self.coordinates, self.orders)
        fine = max(FINE, count)
        gap, normal = self.history("gap", fine), self.history("normal_force", fine)
        friction, unilateral = problem.friction, problem.opens
        along = dict(zip(model.tangent_directions, ("", SECOND), strict=False))  # direction -> before a history's name
        gaps = indicators.measure_separation(self.history("gap", count)[:, unilateral])
        slides = friction > 0
        work = indicators.measure_work(self.excitation, self.coordinates, self.orders)
        dissipated = indicators.measure_work(viscous, self.coordinates, self.orders)
        period = 2 * np.pi / (problem.omega or 1.0)
        rubbed, truncated = 0.0, [np.zeros((fine, np.count_nonzero(slides)))]
        for direction, which in along.items():
            acts = problem.system.row_of(direction, np.arange(model.pairs)) >= 0
            force, speed = (self.history(which + n, count) for n in ("admissible_friction_force", "slip_velocity"))
            rubbed -= period * np.sum(np.mean(force * speed, axis=0))
            truncated.append((self.history(which + "friction_force", fine) * acts)[:, slides])  # bonds have no cone
        scale = max(abs(work), dissipated + abs(rubbed), np.finfo(float).tiny)
        figures = {
            "penetration": max(0.0, -float(gap[:, unilateral].min(initial=0.0))),
            "tension": max(0.0, -float(normal[:, unilateral].min(initial=0.0))),
            "largest_normal_force": float(normal.max(initial=0.0)),
            "cone_violation": indicators.measure_cone_violation(
                np.hypot.reduce(truncated, axis=0), normal[:, slides], friction[slides]
            ),
            "excitation_work": work,
            "viscous_dissipation": dissipated,
            "friction_dissipation": float(rubbed),
            "energy_error": (work - dissipated - float(rubbed)) / scale,
            "J_T": float(np.mean(indicators.measure_sliding(self.sliding_speed(), period))),
            "J_N": float(np.mean(gaps)) if gaps.size else 0.0,
        }
        for name in model.outputs:
            figures[f"rms_{name}"] = indicators.measure_rms(self.output(name), self.orders)
        return figures

    @cached_property
    def cautions(self) -> tuple[str, ...]:
        """What speaks against trusting a converged solution as it is, a line each."""
        if not self.converged:
            return ()
        merit, coarse = self.merit, []
        dissipated = abs(merit["viscous_dissipation"]) + merit["friction_dissipation"]
        little = LITTLE_EXCHANGE * self._swinging
        normal = [laws.kinds[0] for _, laws in self.problem.groups]
        tells = self.problem.frequency and all(  # of truncation: at rest there is none
            kind.only_pushes for kind in normal if kind.acts_in(self.problem.model.tangents)
        )
        if tells and abs(merit["energy_error"]) > COARSE_ENERGY and dissipated > little:
            coarse.append(f"energies are out of balance by {merit['energy_error']:.1%}")
        if tells and self.touches and merit["tension"] > COARSE_TENSION * merit["largest_normal_force"]:
            coarse.append(f"contact pulls by up to {merit['tension']:.3g} N of {merit['largest_normal_force']:.3g} N")
        lines = [f"truncation is coarse: {', '.join(coarse)}; see what more harmonics change"] if coarse else []
        lines += self._list_few_samples() + self._list_few_multiples() + self._list_missing()
        lines += self.list_broken_symmetry() + self.list_hit_modes()
        if merit["viscous_dissipation"] < -little:
            lines.append(f"the damping matrix feeds {-merit['viscous_dissipation']:.3g} J a cycle: was its sign meant?")
        lines += list_ignored(self.problem) + tell_missed_mean(self) + tell_history(self)
        lines += tell_unpressed(self) + ([str(self.walks_slowly)] if self.walks_slowly else [])
        if self.unstable:
            where_to = tell_where_to(self.problem, self.alternates, self.multiplier)
            unstable = f"unstable: motions in time leave it{where_to}"
        if self.fallbacks:
            stable = f"this one is {unstable}" if self.unstable else "the stability of this one is not known"
            lines.append(f"found by a fallback: there may be other solutions, and {stable}")
        elif self.unstable:
            lines.append(unstable)
        return tuple(lines + self._list_unfollowed())

    @cached_property
    def walks_slowly(self) -> Walk | None:
        """How a body that hangs on friction walks a little every cycle, so that its mean means nothing; or None."""
        if not (self.converged and self.rigid.size and self.merit["J_T"]):  # what does not slide does not walk
            return None
        balance, unknowns = self.pose()
        if not balance.hangs_on_friction:
            return None
        expected = measure_walk(balance, unknowns)
        walk = watch_walk(self, balance, expected) or expected
        return walk if walk.slow else None

    def _list_unfollowed(self) -> list[str]:
        """Where the largest multiplier is not looked for: in a ring, or because of what a law of one's own sees."""
        looked_at = self.orders[-1] and not self.unstable
        if looked_at and self.problem.model.cyclic:
            return self._list_growth_round_the_ring()
        if not (self.problem.own_kinds and self.problem.system.laws and looked_at):
            return []
        unfollowed = list_unfollowed(self._forgetful)
        told = "; ".join(f"{name} sees {' and '.join(seen)}" for name, seen in unfollowed.items())
        return [f"stability is not looked at: {told}"] if told else []

    def _list_growth_round_the_ring(self) -> list[str]:
        """Whether deviations of other nodal diameters are seen to grow; that none is proves little."""
        growth = self.ring_growth
        if leaves(growth):
            waves = f"{growth.diameters} nodal diameter{'s' * (growth.diameters != 1)}"
            grow = f"deviations of {waves} grow by {growth.factor - 1:.0%} a period"
            if not self.problem.system.laws:  # nothing is truncated
                return [f"unstable: {grow}; integrate(...) on unroll_ring(model) shows how"]
            told = f"perhaps unstable: as truncated forces have it, {grow}"
        elif self._rubs_or_taps:
            told = "stability is not looked at" if growth is None else "stability is not known: no deviation grows much"
        else:
            return []
        whether = "whether motions in time leave the wave that travels round the ring"
        return [f"{told}; {whether} shows in integrate(...) on unroll_ring(model)"]

    @cached_property
    def _swinging(self) -> float:
        """Energy that swings to and fro over a period, beside which what is gained and lost may be rounding [J]."""
        strained = np.abs(self.forces) ** 2 @ self.problem.system.flexibility  # where contact stops all, motion rounds
        moved = np.sum(np.abs(self.excitation * self.coordinates), axis=1)
        return np.pi * float(np.array(self.orders) @ (moved + strained))

    @property
    def _rubs_or_taps(self) -> bool:
        """Whether contact makes harmonics of its own."""
        return self.merit["friction_dissipation"] > LITTLE_EXCHANGE * self._swinging or self._taps

    def _list_few_samples(self) -> list[str]:
        """Where samples are so few that what laws excite above the harmonics kept passes for these."""
        basis, top = self.problem.basis, self.orders[-1]
        if basis.samples > FEW_SAMPLES * top or not self._rubs_or_taps:
            return []
        return [
            f"samples = {basis.samples} a period are few for harmonic {top}: forces above the harmonics kept pass for "
            f"some of these; give more than {FEW_SAMPLES * top}, or None"
        ]

    def _list_few_multiples(self) -> list[str]:
        """Where loads at high harmonics leave few of their multiples: a number of harmonics counts all of them."""
        base = int(np.gcd.reduce([h for h in self.problem.driven if h] or [1]))
        if base == 1 or self.orders[-1] // base >= FEW_MULTIPLES or not self._rubs_or_taps:
            return []
        few = f"all loads act at multiples of harmonic {base}, and few of these are kept"
        return [f"{few}: give harmonics = {5 * base} or more, or the loads' own frequency with loads at harmonic 1"]

    def _list_missing(self) -> list[str]:
        """Where a list of harmonics lacks some, below its highest, at which the laws would have contact forces."""
        kept = {*self.orders, *self.left_out}
        share, worst = self._find_unmet([h for h in range(self.orders[-1]) if h not in kept])
        if not share > MISSED:
            return []
        told = f"{share:.0%} of the oscillating contact forces at harmonic {worst}, which is not kept"
        return [f"the laws would have {told}: add it, or give the highest harmonic as a number to keep all up to there"]

    def list_broken_symmetry(self) -> list[str]:
        """Where a law of one's own is said to be odd, and would have contact forces that its symmetry left out."""
        own = self.problem.own_kinds
        share, worst = self._find_unmet(self.left_out if own else ())
        if not share > MISSED:
            return []
        told = f"{share:.0%} of the oscillating contact forces at harmonic {worst}, which was left out by symmetry"
        return [
            f"the laws would have {told}: is odd = True right of {', '.join(own)}, and blind_to_mean, if it says so?"
        ]

    def _find_unmet(self, harmonics: Sequence[int]) -> tuple[float, int]:
        """What the laws ask for at harmonics without forces, over all oscillating forces: the largest, and where."""
        if not harmonics or not self.problem.system.laws:
            return 0.0, 0
        balance, wave = self.pose()[0], FourierBasis(tuple(harmonics), self.problem.basis.samples)
        seen = balance.sample(self.forces, self.row_motion)
        unmet = [law.evaluate(motion).residual for law, motion in zip(self.problem.system.laws, seen, strict=True)]
        size = np.linalg.norm(wave.to_amplitudes(wave.project(np.hstack(unmet))), axis=1)
        share = size / max(np.linalg.norm([*size, np.linalg.norm(self.forces[np.array(self.orders) > 0])]), TINY)
        worst = int(np.argmax(share))
        return float(share[worst]), harmonics[worst]

    def list_hit_modes(self) -> list[str]:
        """Where a harmonic hits a mode without damping: what is left of its dynamic stiffness there is rounding."""
        strain, drag, inertia = (
            self._rate**power * self.problem.model.react(name, self.coordinates, self.orders)
            for power, name in enumerate(("stiffness", "damping", "mass"))
        )
        left, size = (np.linalg.norm(forces, axis=1) for forces in (strain + inertia + drag, strain))
        return [tell_hit(h) for h, hit in zip(self.orders, left < HIT * size, strict=True) if h and hit]

    def list_reservations(self) -> list[str]:
        """What was tried before it was found, and ``cautions``; empty where the first attempt left nothing to say."""
        return [*(f"fallback: {rung}" for rung in self.fallbacks), *self.cautions]

    @cached_property
    def side(self) -> int:
        """Side of the branch's folds: -1 between two of them, else 1; 0: not looked at. See ``stability.py``."""
        return find_side(*self.pose()) if self.converged and self.problem.system.rows.shape[0] else 0

    @cached_property
    def alternates(self) -> bool:
        """Whether motions in time leave it by alternating from period to period; looked at where pairs tap."""
        turns = self.converged and self._taps and alternates(self)
        return turns and not self._settles

    @cached_property
    def grows(self) -> bool:
        """Whether motions in time leave it without turning: looked at where ``side`` is negative."""
        seen = self.side < 0 and grows(self._forgetful) is not False
        return seen and not self._settles

    @cached_property
    def multiplier(self) -> complex:
        """The largest Floquet multiplier beyond the unit circle, if one is seen, else 0; at rest there is none.

        See ``floquet.py``.
        """
        if not self.converged:
            return 0.0
        found = find_growth(self._forgetful)
        return 0.0 if found and self._settles else found

    @cached_property
    def ring_growth(self) -> RingGrowth | None:
        """Of a sector of a ring: the deviation, of any nodal diameters, that grows most; None: it is not looked at.

        See ``ring_growth.py``.
        """
        if not (self.converged and self.problem.model.cyclic and self.orders[-1]):
            return None
        return find_ring_growth(self._forgetful)

    @cached_property
    def _taps(self) -> bool:
        """Whether a pair opens and closes within the period."""
        return any(np.any(state.any(axis=0) & ~state.all(axis=0)) for state in self._open)

    @cached_property
    def _settles(self) -> bool:
        """Whether the motion in time settles beside it."""
        return settles(self._forgetful)

    @cached_property
    def _forgetful(self) -> PeriodicSolution:
        """The solution under laws that remember nothing: dashpots stand for springs and masses.

        Where masses reverse, dashpots would at other samples: the motion is that to which Newton's method leads under
        them, if it settles soon; where it does not, under lighter ones, with which motions are nearer.
        """
        closures = self.problem.system.closures
        if not closures:
            return self
        here = replace(self, problem=replace(self.problem, closure="dashpot"))
        if "masses" not in closures:
            return here
        closed = np.concatenate([law.pairs for law in self.problem.system.laws if law.closes == "masses"])
        for problem in weigh_lighter(here.problem, closed):
            there = replace(here, problem=problem)
            balance, unknowns = there.pose()
            found, _ = balance.take_whole_steps(unknowns, SETTLING, balance.within(SETTLED))
            if found is not None:
                forces, rigid = balance.unpack(found)
                return replace(there, forces=forces, rigid=rigid)
        return here

    @property
    def unstable(self) -> bool:
        """Whether a Floquet multiplier is seen beyond the unit circle; not all are, and none at rest.

        See ``stability.py``.
        """
        return self.grows or self.alternates or self.multiplier != 0

    @cached_property
    def touches(self) -> bool:
        """Whether pairs that may part ever close; True where none may part."""
        return not self._open or not all(np.all(state) for state in self._open)

    @cached_property
    def _open(self) -> list[np.ndarray]:
        """Which pairs are open, ``(n_t, K)``, for each law under which they may part."""
        fields = [seen for law, seen in self.law_fields(self.problem.basis) if law.direction == "normal"]
        return [seen["open"] for seen in fields if "open" in seen]

    @cached_property
    def _told_error(self) -> str:
        return self.tell_error(self) if self.tell_error and self.converged else ""

    def summary(self) -> str:
        """A few lines for people."""
        state = "converged" if self.converged else f"NOT converged ({self.reason})"
        where = "at rest"
        if self.orders[-1]:
            first, last, count = self.orders[0], self.orders[-1], len(self.orders)
            some = "" if count == last - first + 1 else f" ({count} of them)"
            where = f"{self.problem.frequency:g} Hz, harmonics {first}..{last}{some}"
        lines = [
            f"{where}: {state} in {self.iterations} Newton step{'s' * (self.iterations != 1)}, "
            f"{self.unknowns} unknowns, residual {self.residual:.1e}, {self.seconds:.2f} s"
        ]
        if not np.isnan(self.estimated_error):
            lines.append(f"  estimated error {self.estimated_error:.1g}")
        if self._told_error:
            lines.append(f"  {self._told_error}")
        if self.short:
            lines.append(f"  NOT as accurate as asked: {self.short}")
        if not self.touches:
            told = "no pair ever touches: the bodies are apart"
            if not np.all(self.problem.opens):
                told = "no pair that may part ever touches: the other pairs alone join the bodies"
            lines.append(f"  {told}; are gaps in m, and does a load close them?")
        if self.left_out:
            some = [str(h) for h in self.left_out]
            if len(some) > LISTED:
                some[3:-1] = ["..."]
            lines.append(f"  harmonics {', '.join(some)} left out: {self.why_left_out}")
        lines += [f"  {line}" for line in self.list_reservations()]
        return "\n".join(lines)


def tell_hit(harmonic: int) -> str:
    """What to say of a harmonic at which next to nothing holds a mode."""
    return (
        f"harmonic {harmonic} hits a mode without damping, and rounding decides how far it swings: add damping, or "
        "move the frequency"
    )
