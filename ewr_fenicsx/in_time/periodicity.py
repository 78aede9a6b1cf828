"""From one period to the next: how much a motion still changes, and where its steady state should lie."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.in_time.compiled_loop import FRICTION
from ewr_fenicsx.in_time.time_stepping import Period, TimeScheme

# A motion that hardly oscillates is judged by something larger: by its mean (a body at rest is steady), by the modal
# motions that cancel in it, of which it may be the rounding (a pair that sticks does not slip), by what it would be if
# all that moves moved it (an output that is zero by symmetry), or by what the load alone would move in a step (nothing
# moves where all sticks). Where no load oscillates, what still moves is rounding beside where all is.
_STILL, _CANCELLED, _ROUNDED = 1e-4, 1e-3, 1e-6
_SAME, _GONE = 1e-2, 1e-2  # change of velocities, and of positions, over the largest speed and the way at it
# Difference between the ways that a body goes in two periods, over the way; where it is short; and of what fades away.
_ALIKE, _CONSTANT, _FADES = 0.5, 1e-3, 1e-3
WALKS = "every period ends elsewhere with the velocities that it began with: a body walks"
_WINDOW = 6  # periods that the extrapolation looks back on
_STEADILY = 10  # periods, each of which has to change less than the one before, for a motion that decays
_REMEMBERED = 12  # periods whose differences tell of deviations that grow (``surroundings.py``)


def find_end(period: Period) -> RealArray:
    """State ``(2 n',)`` at a period's end."""
    return np.concatenate([period.positions[-1], period.velocities[-1]])


def count_missing(changes: Sequence[float], tolerance: float) -> int:
    """Periods missing to a tolerance where each one changes less than the one before; 0 where not, or none is set."""
    last = np.array(changes[-_STEADILY - 1 :])
    if not tolerance or last.size <= _STEADILY or not np.all(np.diff(last) < 0) or not 0 < last[-1] < last[0] < np.inf:
        return 0  # the change of the first period is infinite
    return int(np.ceil(_STEADILY * np.log(tolerance / last[-1]) / np.log(last[-1] / last[0])))


class Watch:
    """Follows outputs, pair motions and masses from period to period.

    Forces at pairs that neither slip nor open follow from how the masses move, of which no output need tell.

    Attributes:
        second_change: Relative change of the last period since the one before the one before it.
        ways: How far the modal coordinates have gone in each of the last three periods, ``(n',)``.
    """

    def __init__(self, scheme: TimeScheme):
        self.names = list(scheme.problem.model.outputs)
        readers = [scheme.problem.model.outputs[name] @ scheme.expansion for name in self.names]
        self.readers = np.vstack([*readers, scheme.rows])
        self.inertia = np.sqrt(np.maximum(scheme.mass, 0.0))
        count, followed = len(self.names), len(self.readers)
        self.groups = np.repeat([*range(count), count, count + 1], [*[1] * count, followed - count, self.inertia.size])
        self.history = [np.zeros((0, len(self.names)))]
        self.earlier: list[RealArray] = []
        self.second_change = np.inf
        self.ways: list[RealArray] = []
        self.reach = np.append(np.linalg.norm(self.readers, axis=1), self.inertia)  # modes have a unit of inertia each
        self.rests = not any(scheme.problem.driven)
        self.pushed = self._sum_up(scheme.dt * np.abs(scheme.velocity_of_load))

    def _sum_up(self, sizes: RealArray) -> RealArray:
        """What is followed at most, of modal motions of these sizes."""
        return np.hstack([sizes @ np.abs(self.readers.T), sizes * self.inertia])

    def record(self, period: Period) -> None:
        """Keep a period's outputs, also of a motion that grew past all numbers."""
        with np.errstate(over="ignore", invalid="ignore"):
            self.history.append(period.positions @ self.readers[: len(self.names)].T)

    def measure_change(self, period: Period) -> float:
        """Relative change since the period before: the largest of each output's, all pairs' and all masses' motions."""
        motion = np.hstack([period.positions @ self.readers.T, period.positions * self.inertia])
        total = lambda values: np.bincount(self.groups, weights=np.mean(values**2, axis=0))  # noqa: E731
        modal = period.positions
        scale = total(motion - motion.mean(axis=0))
        for share, size in (
            (_STILL, total(motion)),
            (_CANCELLED, total(self._sum_up(np.abs(modal - modal.mean(axis=0))))),
            (_ROUNDED, total(self._sum_up(np.abs(modal)))),
            (_ROUNDED, total(np.sqrt(modal.var(axis=0).sum()) * self.reach[None])),
            (_ROUNDED * self.rests, total(np.sqrt(np.mean(modal**2, axis=0).sum()) * self.reach[None])),
            (_ROUNDED, total(self.pushed)),
        ):
            scale = np.maximum(scale, share**2 * size)
        changes = [np.inf, np.inf]
        for k, before in enumerate(reversed(self.earlier)):
            change = np.divide(total(motion - before), scale, out=np.zeros_like(scale), where=scale > 0)
            changes[k] = float(np.sqrt(change.max(initial=0.0)))
        self.earlier = [*self.earlier, motion][-2:]
        self.second_change = changes[1]
        self.ways = [*self.ways, period.positions[-1] - period.positions[0]][-3:]
        return changes[0]

    @property
    def transients(self) -> dict[str, RealArray]:
        """Output name -> its values at all steps of all periods that were recorded."""
        values = np.concatenate([part[i > 1 :] for i, part in enumerate(self.history)])  # periods share their ends
        return {name: values[:, i] for i, name in enumerate(self.names)}


def tell_walk(period: Period, ways: Sequence[RealArray], scheme: TimeScheme) -> str:
    """What to say where a period ends with the velocities that it began with, but elsewhere: a body moves on with each.

    Only what no spring holds does: a body on springs that creeps to where they hold it comes to rest there. ``ways`` is
    as in ``Watch``: a body that has moved in one period alone may have come to rest as well, and one whose ways fade
    away is to. A body that friction ought to stop may drift on for ever, by what it changes its velocity in half a
    step: friction is none the other as long as it turns within the same step.

    Returns:
        "" where none does.
    """
    floats = scheme.contraction @ scheme.layout.expansion @ scheme.layout.model.rigid_modes
    moved = np.array(ways) @ floats @ np.linalg.pinv(floats)
    if not floats.size or len(moved) < 3:
        return ""
    weight = np.sqrt(np.maximum(scheme.mass, 0.0))
    speed = np.abs(weight * period.velocities).max(initial=0.0)
    changed = np.abs(weight * (period.velocities[-1] - period.velocities[0])).max(initial=0.0)
    gone, differs = (np.linalg.norm(weight * way) for way in (moved[-1], moved[-1] - moved[-2]))
    pushed = scheme.dt * np.abs(weight * scheme.velocity_of_load).max(initial=0.0)
    duration = scheme.steps * scheme.dt
    alike = _ALIKE if gone > _GONE * speed * duration else _CONSTANT
    rounding = _ROUNDED * max(pushed, speed * duration)  # where all sticks, it is all that moves
    fading = fades((weight * moved) @ (weight * moved[-1]))
    if changed > _SAME * speed or gone <= rounding or differs > alike * gone or fading:
        return ""
    turned = 0.5 * duration * np.abs(weight * np.diff(period.velocities, axis=0)).max()
    if np.any(scheme.kind == FRICTION) and gone <= turned:
        return f"{WALKS}, or drifts by no more than steps as long as these do not tell from none; take more of them"
    return WALKS


def fades(values: Sequence[float]) -> bool:
    """Whether the last three values, positive at last, fall so that less than half of that is left in the end."""
    before, last = np.diff(values[-3:])
    if not (before < 0 and last < -_FADES * values[-1]):
        return False
    return bool(last <= before or values[-1] - last**2 / (last - before) < 0.5 * values[-1])


class Anderson:
    """Anderson's acceleration of the map from the state at a period's start to the one at its end.

    States are measured by their kinetic energy, positions times ``omega``: the stiffest modes ring from step to step
    and would drown the rest in an elastic norm.

    Extrapolation finds motions that others leave as well as those to which they come: see ``surroundings.py``.

    Attributes:
        weight: ``(2 n',)`` of a state's entries in its size.
        oscillation: Size of the rms oscillation in the last period; where there is next to none, of what a change is
            judged by then.
        defect: Distance of the last period's end from its start, relative to the oscillation.
        distance: How far the last extrapolation reaches beyond that end, relative to the same: the distance left.

    Source: Walker & Ni (2011), doi:10.1137/10078356X.
    """

    def __init__(self, scheme: TimeScheme):
        root = np.sqrt(np.maximum(scheme.mass, 0.0))
        self.weight = np.concatenate([scheme.problem.omega * root, root])
        self._pushed = np.linalg.norm(root * scheme.velocity_of_load) / np.sqrt(scheme.steps)
        self._ends: list[RealArray] = []
        self._residuals: list[RealArray] = []
        self.oscillation = 1.0
        self.defect = self.distance = np.nan

    def extrapolate(self, start: RealArray, end: RealArray, period: Period) -> RealArray:
        """State ``(2 n',)`` from which the next period should start, from this period and the last few."""
        self._ends = [*self._ends, end][-_REMEMBERED:]
        self._residuals = [*self._residuals, self.weight * (end - start)][-_REMEMBERED:]
        correction = np.zeros_like(end)
        if len(self._ends) > 1:
            change, ways = (np.diff(values[-_WINDOW:], axis=0) for values in (self._residuals, self._ends))
            correction = -np.linalg.lstsq(change.T, self._residuals[-1], rcond=1e-10)[0] @ ways
        states = np.hstack([period.positions, period.velocities]) * self.weight
        swing, still = np.sqrt(states.var(axis=0).sum()), np.sqrt(np.mean(states**2, axis=0).sum())
        self.oscillation = oscillation = max(swing, _STILL * still, _ROUNDED * self._pushed, np.finfo(float).tiny)
        self.defect = float(np.linalg.norm(self._residuals[-1]) / oscillation)
        if len(self._ends) > 1:
            self.distance = float(np.linalg.norm(self.weight * correction) / oscillation)
        return end + correction

    @property
    def deviations(self) -> tuple[RealArray, RealArray]:
        """Differences of the last states, weighted, at periods' starts and at their ends, ``(2 n', k)`` each."""
        ends, residuals = (np.diff(values, axis=0).T for values in (self._ends, self._residuals))
        return self.weight[:, None] * ends - residuals, ends
