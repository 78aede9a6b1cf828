"""Coulomb's dry friction along one line, the harmonics left out closed by the pair's own mass.

A truncated friction force and the admissible one differ by harmonics that the balance has no equation for. A mass that
rubs by itself answers to them with its inertia. Its surface then moves under the admissible force ``f``, whatever the
harmonics of that: ``m dV/dt = m a + f - lam`` with the acceleration ``a`` and the force ``lam`` of the harmonics kept.
Where the mass slides, ``f`` is the limit and opposes ``V``; where it sticks, ``f`` holds it.

Forces are constant over the interval around each sample, and reversals are found within it. Momenta ``u = m V`` over
the interval's length are all that is needed: ``u_i = u_(i-1) + g_i + f_i`` with the drive ``g = m a - lam``.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign
from typing import NamedTuple

import numpy as np

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.laws.cone import FrictionLaw, find_felt
from ewr_fenicsx.laws.law_kinds import Motion, Partial, Response

ROUNDS = 100  # of a period in search of the momentum that comes back
ROUNDING = 1e-14


class Slide(NamedTuple):
    """One period of masses that rub, ``(n_t, K)`` each; a change of momentum is its own sum of three products.

    Attributes:
        momentum: At the end of each sample's interval, over its length [N].
        kept: Derivative by the momentum before: 1, less where the mass reverses, 0 where it comes to rest.
        by_drive, by_limit: Derivatives by the drive and by the limit at the same sample.
        free: ``(K,)`` masses without friction, or with none but rounding, which have no momentum of their own.
    """

    momentum: RealArray
    kept: RealArray
    by_drive: RealArray
    by_limit: RealArray
    free: np.ndarray


def slide(drive: RealArray, limit: RealArray) -> Slide:
    """Periodic momentum of masses driven against dry friction.

    The momentum after a period rises with the one before, by less where the mass came to rest or reversed: Newton's
    method within bounds finds the one that comes back. What is driven off, faster from period to period, has none: it
    is stopped once a period, where it is slowest, and so slides one way throughout.

    Args:
        drive: ``g``, ``(n_t, K)`` [N].
        limit: ``c >= 0``, ``(n_t, K)`` [N].
    """
    free = ~np.any(find_felt(limit), axis=0)  # any momentum comes back beside rounding
    columns = zip(drive.T.tolist(), limit.T.tolist(), free, strict=True)
    found = [_run_period(0.0, g, c) if slides else _find_periodic(g, c) for g, c, slides in columns]
    periods = np.array(found).reshape(-1, len(drive), 4)
    return Slide(*np.moveaxis(periods, 2, 0).transpose(0, 2, 1), free)


def _find_periodic(drive: list[float], limit: list[float]) -> list[tuple[float, ...]]:
    """One mass that rubs: ``(momentum, kept, by_drive, by_limit)`` at every sample."""
    start, low, high, stride = 0.0, -np.inf, np.inf, 1.0
    small = ROUNDING * len(drive) * max(map(abs, (*drive, *limit)))
    for _ in range(ROUNDS):
        period = _run_period(start, drive, limit)
        change, way = period[-1][0] - start, copysign(1.0, period[-1][0])
        speeds = [way * momentum for momentum, *_ in period]
        slowest = min(speeds)
        one_way = slowest > 0 and way * start >= 0
        if one_way and way * change >= -small:
            return _stop_once(speeds.index(slowest), drive, limit)
        if abs(change) <= small:
            break
        low, high = (start, high) if change > 0 else (low, start)
        slope = float(np.prod([kept for _, kept, _, _ in period]))
        if one_way:
            start += change * (slowest // abs(change) + 1.0)
        elif slope < 1.0:
            start += change / (1.0 - slope)
        else:  # it reverses where nothing rubs
            start, stride = start + stride * change, 2.0 * stride
        if not low < start < high:
            start = (low + high) / 2
    return period


def _stop_once(where: int, drive: list[float], limit: list[float]) -> list[tuple[float, ...]]:
    """``_find_periodic`` from rest at a sample to that sample again, where it comes to rest."""
    turn = where + 1
    period = _run_period(0.0, drive[turn:] + drive[:where], limit[turn:] + limit[:where])
    ahead = len(drive) - turn
    return [*period[ahead:], (0.0, 0.0, 0.0, 0.0), *period[:ahead]]


def _run_period(momentum: float, drive: list[float], limit: list[float]) -> list[tuple[float, ...]]:
    """``_find_periodic`` from a momentum, over one period."""
    period = []
    for force, cone in zip(drive, limit, strict=True):
        way = copysign(1.0, momentum or force)
        end, kept, by_drive, by_limit = momentum + force - way * cone, 1.0, 1.0, -way
        if momentum == 0.0 and abs(force) <= cone:
            end, by_drive, by_limit = 0.0, 0.0, 0.0
        elif way * end < 0.0:  # it stops within the interval
            share = momentum / (way * cone - force)
            if abs(force) <= cone:
                end, kept, by_drive, by_limit = 0.0, 0.0, 0.0, 0.0
            else:  # and goes on the other way
                end = (force + way * cone) * (1 - share)
                kept = (force + way * cone) / (force - way * cone)
                by_drive, by_limit = (1 - share) + kept * share, way * ((1 - share) - kept * share)
        period.append((end, kept, by_drive, by_limit))
        momentum = end
    return period


@dataclass(frozen=True, eq=False)
class InertialCoulomb(FrictionLaw):
    """Dry friction in one tangential direction with the true, varying cone, closed by masses.

    The residual is what the mass's momentum lacks of the harmonics kept. Its mean, which would vanish for any mean
    force, is ``m omega`` times the mean velocity: the surfaces must not drift apart. What slides one way throughout
    does, and so solves nothing; without friction, the force itself is to vanish.

    Args:
        mass: ``(K,)`` of each pair at the harmonics left out, positive [kg].
        period: Of the motion [s].
    """

    mass: RealArray
    period: float = 0.0
    closes: str = "masses"

    def run(self, motion: Motion) -> tuple[Slide, RealArray]:
        """How the masses slide, and the admissible friction force ``(n_t, K)`` [N]."""
        drive = self.mass * motion.acceleration["tangential"] - motion.force["tangential"]
        found = slide(drive, self.limit(motion.force))
        force = found.momentum - np.roll(found.momentum, 1, axis=0) - drive
        return found, np.where(found.free, 0.0, force)

    def evaluate(self, motion: Motion) -> Response:
        found, force = self.run(motion)
        free = found.free
        drift = np.where(free, 0.0, 2 * np.pi / len(force) * found.momentum.mean(axis=0))
        by_drive, by_limit = (np.where(free, 0.0, part) for part in (found.by_drive, found.by_limit))
        closes = self.friction * (motion.force["normal"] > 0)
        ones = np.ones_like(force)
        return Response(
            motion.force["tangential"] - force - drift,
            (
                Partial("force", "tangential", free * ones),
                Partial("acceleration", "tangential", ~free * self.mass * ones),
                Partial("acceleration", "tangential", -self.mass * by_drive, kept=found.kept),
                Partial("force", "tangential", by_drive, kept=found.kept),
                Partial("force", "normal", -by_limit * closes, kept=found.kept),
            ),
        )

    def fields(self, motion: Motion) -> dict[str, RealArray]:
        found, force = self.run(motion)
        rests = (found.momentum == 0) & (np.roll(found.momentum, 1, axis=0) == 0)
        moved = found.momentum * (self.period / len(force)) ** 2 / self.mass  # from one interval's middle to the next
        own = motion.displacement["tangential"]
        return {
            "admissible_friction_force": force,
            "slipping": ~rests,
            "surface_slip": np.where(found.free, own, np.roll(moved, 1, axis=0).cumsum(axis=0)),
        }
