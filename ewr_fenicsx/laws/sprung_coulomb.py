"""Coulomb's dry friction along one line, the harmonics left out closed by springs.

A truncated friction force and the admissible one differ by harmonics that the balance has no equation for. On them the
structure is taken for a spring between the pair's two surfaces, ``q_h = d lam_h``, with the pair's own flexibility
``d``. The surfaces then stick where ``q + d (f - lam)`` rests: the admissible force ``f`` follows ``lam - q / d`` while
the pair sticks, is the limit while it slips, and remembers between two slips where the last one ended (a stop operator
with a limit that varies). Springs take nothing from the motion over a period, where the dashpots of ``coulomb.py`` do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.laws.cone import FrictionLaw, find_felt
from ewr_fenicsx.laws.law_kinds import Motion, Partial, Response


class Stop(NamedTuple):
    """One period of a stop operator, ``(n_t, K)`` each.

    Attributes:
        force: The force.
        since: Sample of the last slip: its own where the pair slips; -1 where it never does.
        sign: Limit that was met there, 1 or -1; 0 where none was.
    """

    force: RealArray
    since: np.ndarray
    sign: np.ndarray


def run_stop(drive: RealArray, limit: RealArray) -> Stop:
    """Periodic force that follows a drive as far as a limit lets it.

    From sample to sample ``f_i = clip(f_(i-1) + u_i - u_(i-1), -c_i, c_i)``. The offset ``f - u`` is clipped into one
    interval a sample; clipping twice is clipping once, so that the intervals of a period compose in pairs, and pairs
    of pairs. What never slips may have any offset within limits: it has the one nearest to none.

    Args:
        drive: ``u``, ``(n_t, K)`` [N].
        limit: ``c >= 0``, ``(n_t, K)`` [N].

    Source: Visintin (1994), Differential Models of Hysteresis, doi:10.1007/978-3-662-11557-2 (the stop operator).
    """
    low, high = -limit - drive, limit - drive
    least, most = low.copy(), high.copy()  # by all samples up to each
    reach = 1
    while reach < len(drive):
        lower, upper = (np.minimum(np.maximum(b[:-reach], least[reach:]), most[reach:]) for b in (least, most))
        least[reach:], most[reach:] = lower, upper
        reach *= 2
    offset = np.clip(np.clip(0.0, least[-1], most[-1]), least, most)
    before = np.roll(offset, 1, axis=0)
    sign = np.where(before >= high, 1, np.where(before <= low, -1, 0))
    since = np.maximum.accumulate(np.where(sign != 0, np.arange(len(drive))[:, None], -1), axis=0)
    since = np.where(since < 0, since[-1], since)  # slips of the period before
    sign = np.where(since < 0, 0, np.take_along_axis(sign, since, axis=0))
    return Stop(drive + offset, since, sign)


@dataclass(frozen=True, eq=False)
class SprungCoulomb(FrictionLaw):
    """Dry friction in one tangential direction with the true, varying cone, closed by springs.

    Args:
        flexibility: ``(K,)`` of each pair by itself at the harmonics left out, positive [m/N].
    """

    flexibility: RealArray
    closes: str = "springs"

    @property
    def impedance(self) -> RealArray:
        return 1 / self.flexibility

    def drive(self, motion: Motion) -> RealArray:
        """Force ``(n_t, K)`` that the springs would follow, were there no limit [N]."""
        return motion.force["tangential"] - motion.oscillation["tangential"] / self.flexibility

    def evaluate(self, motion: Motion) -> Response:
        drive, limit = self.drive(motion), self.limit(motion.force)
        force, since, sign = run_stop(drive, limit)
        slips = since == np.arange(len(since))[:, None]
        cone = np.where(slips & find_felt(limit), -sign * self.friction, 0.0)
        slipping, sticking = np.where(slips, 1.0, 0.0), np.where(slips, 0.0, 1 / self.flexibility)
        earlier = np.where(slips, -1, since)  # what sticks takes over from its last slip
        return Response(
            motion.force["tangential"] - force,
            (
                Partial("force", "tangential", slipping),
                Partial("oscillation", "tangential", sticking),
                Partial("force", "normal", cone),
                Partial("force", "tangential", slipping, earlier),
                Partial("oscillation", "tangential", -slipping / self.flexibility, earlier),
                Partial("force", "normal", cone, earlier),
            ),
        )

    def fields(self, motion: Motion) -> dict[str, RealArray]:
        force, since, _ = run_stop(self.drive(motion), self.limit(motion.force))
        bent = self.flexibility * (force - motion.force["tangential"])
        return {
            "admissible_friction_force": force,
            "slipping": since == np.arange(len(since))[:, None],
            "surface_slip": motion.oscillation["tangential"] + bent,
        }
