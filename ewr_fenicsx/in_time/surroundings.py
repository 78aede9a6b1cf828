"""Whether motions in time that begin a little beside a steady one leave it.

What the period map makes of small deviations is learnt from the last states that were met on the way to the steady
motion; where these do not tell, from some periods more: the first begins at random a little beside it, each other one
where what became of the last deviation points, for what grows prevails. A deviation that is to grow, stepped on,
decides.

Source (the map on the space of its own iterates): Saad (2011), Numerical Methods for Large Eigenvalue Problems,
doi:10.1137/1.9781611970739.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.in_time.compiled_loop import FRICTION
from ewr_fenicsx.in_time.periodicity import Anderson, find_end
from ewr_fenicsx.in_time.time_stepping import BOUND, Carried, Period, TimeScheme

# Differences of states above a share of the oscillation tell; apart from each other by some others (each misses what
# another one sees); multipliers from which on it is looked what becomes of a small one: whether it grows by a factor,
# falls by one (what is left may grow then), or has grown somewhat after so many periods: modes that beat with each
# other make up for a little less.
_TOLD, _APART, _GROWING = 1e-6, (1e-3, 1e-2, 1e-1), 1.01
_FAR, _FALLEN, _GROWN, _FOLLOWED = 3.0, 10.0, 1.5, 40
# Share of the oscillation that is small. What friction stops within a step loses what it deviates by: where it stops
# masses a deviation is not smaller than what the oscillation goes through in some steps.
_SMALL, _SOME = 1e-3, 2.0
_MASS = 0.5  # share of a mode's mass in what resists it in a step, from which on it is a mass that moves
_BESIDE = 10  # periods that begin beside the steady motion, at most


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What is next to a steady motion.

    Args:
        scheme: The scheme.
        last: The last period of the steady motion.
        extrapolation: What led to it.
        contact_tolerance, sweeps: As ``TimeScheme.run_period`` takes them.
    """

    scheme: TimeScheme
    last: Period
    extrapolation: Anderson
    contact_tolerance: float
    sweeps: int

    def are_left(self) -> bool:
        """Whether a deviation is found that grows."""
        return self._grow(self.extrapolation.deviations) or self._grow(self._begin_beside())

    def _grow(self, deviations: tuple[RealArray, RealArray]) -> bool:
        """Whether one does that the period map has on the space of deviations, before and after a period."""
        beside = self._find_growing(deviations)
        return beside is not None and self._is_left(beside)

    @cached_property
    def _here(self) -> RealArray:
        """State ``(2 n',)`` of the steady motion at ``tau = 0``."""
        return find_end(self.last)

    @cached_property
    def _small(self) -> float:
        """Size of a small deviation."""
        scheme = self.scheme
        rubs, moved = np.flatnonzero(scheme.kind == FRICTION), scheme.mass > _MASS
        by_masses = np.sum(scheme.rows[np.ix_(rubs, moved)] * scheme.push[np.ix_(moved, rubs)].T, axis=1)
        stops = np.any(by_masses > _MASS * np.diagonal(scheme.delassus_columns)[rubs])
        turned = 2 * np.pi / scheme.steps if stops else 0.0
        return self.extrapolation.oscillation * max(_SMALL, _SOME * turned)

    def _step(self, state: RealArray, carried: Carried) -> Period:
        return self.scheme.run_period(*np.split(state, 2), carried, self.contact_tolerance, self.sweeps)

    def _begin_beside(self) -> tuple[RealArray, RealArray]:
        """Deviations, weighted, at the begin of periods and what becomes of them to their end, ``(2 n', k)`` each."""
        pairs = np.array(list(self._iterate())).reshape(-1, 2, self._here.size)
        return pairs[:, 0].T, pairs[:, 1].T

    def _iterate(self) -> Iterator[tuple[RealArray, RealArray]]:
        """One after the other; the first is at random, of all modes alike in energy."""
        weight, omega = self.extrapolation.weight, self.scheme.problem.omega
        chance = np.random.default_rng(0).standard_normal((2, self.scheme.mass.size))
        deviation = (chance * [[1.0], [omega]] / np.sqrt(self.scheme.stiffness + omega**2 * self.scheme.mass)).ravel()
        end = find_end(self._step(self._here, self.last.carried))
        for _ in range(_BESIDE):
            size = np.linalg.norm(weight * deviation)
            if not size > _TOLD * self._small:  # nothing is left of it, or nothing has a mass
                return
            before = deviation * self._small / size
            deviation = find_end(self._step(self._here + before, self.last.carried)) - end
            if not np.all(np.abs(deviation) < BOUND):
                return
            yield weight * before, deviation

    def _find_growing(self, deviations: tuple[RealArray, RealArray]) -> RealArray | None:
        """The small deviation ``(2 n',)`` that would grow most; None where all are to decay.

        As the period map has it on the space of those deviations, weighted, that differ enough.
        """
        before, after = deviations
        size = np.linalg.norm(before, axis=0)
        differ = size > _TOLD * self.extrapolation.oscillation
        if not np.any(differ):
            return None
        before, after = before[:, differ] / size[differ], after[:, differ] / size[differ]
        space, sizes, mix = np.linalg.svd(before, full_matrices=False)
        multiplier, fastest = _GROWING, None
        for apart in _APART:
            kept = sizes > apart * sizes[0]
            mapped = after @ (mix[kept].T / sizes[kept])
            multipliers, states = np.linalg.eig(space[:, kept].T @ (self.extrapolation.weight[:, None] * mapped))
            most = np.argmax(np.abs(multipliers))
            if abs(multipliers[most]) > multiplier:
                multiplier, fastest = abs(multipliers[most]), mapped @ states[:, most].real
        return None if fastest is None else self._small * fastest

    def _is_left(self, beside: RealArray) -> bool:
        """Whether a motion that begins a deviation ``(2 n',)`` beside the steady one goes away from it."""
        energy = np.sqrt(np.maximum(np.concatenate([self.scheme.stiffness, self.scheme.mass]), 0.0))
        pair, carried, apart = [self._here, self._here + beside], [self.last.carried] * 2, []
        for _ in range(_FOLLOWED):
            periods = [self._step(*each) for each in zip(pair, carried, strict=True)]
            pair, carried = [find_end(period) for period in periods], [period.carried for period in periods]
            apart.append(np.linalg.norm(energy * (pair[1] - pair[0])))
            if not apart[0] / _FALLEN < apart[-1] < apart[0] * _FAR:
                break
        return bool(apart[-1] > _GROWN * apart[0])
