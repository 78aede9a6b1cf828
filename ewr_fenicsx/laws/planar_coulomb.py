"""Coulomb's dry friction in the plane of contact: a disk in place of an interval, with the true, varying cone.

Both tangential directions share one weight and one spring (``layout.py``): nothing depends on where in the plane the
tangents point. Dashpots, the weights, close the truncation.

Source: the equality-based form of the projections of Alart & Curnier (1991), doi:10.1016/0045-7825(91)90022-X.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.laws.cone import FrictionLaw, find_felt
from ewr_fenicsx.laws.law_kinds import TANGENTS, Law, Motion, PairGroup, Partial, Response
from ewr_fenicsx.laws.mean_friction import MeanEquation
from ewr_fenicsx.laws.smoothing import Rounded, round_clip, round_positive_part


def build_in_plane(group: PairGroup, friction: RealArray, mean: MeanEquation) -> tuple[Law, ...]:
    """The two laws of pairs with two tangents, one a direction.

    Args:
        group: The pairs.
        friction: ``(K,)`` coefficients.
        mean: What decides the mean friction, in both directions alike.
    """
    rho = group.weight[TANGENTS[0]]  # that of both directions
    return tuple(PlanarCoulomb(group.pairs, friction, rho, direction=d, **mean._asdict()) for d in TANGENTS)


@dataclass(frozen=True, eq=False)
class PlanarCoulomb(FrictionLaw):
    """One direction of dry friction in a plane; it sees both.

    ``lam_T - s min(1, mu c / |s|) = 0`` with ``s = lam_T - v / rho`` and ``c = max(0, lam_N)``, where ``lam_T`` and
    ``v`` have two components: the trial force ``s`` shrunk into the disk. Along a line it is ``coulomb.Coulomb``.

    Args:
        rho: ``(K,)`` positive weight [(m/s)/N], the same in both directions.
    """

    rho: RealArray

    @property
    def impedance(self) -> RealArray:
        return 1 / self.rho

    def admit(self, trial: Mapping[str, RealArray]) -> RealArray:
        limit, size = self.limit(trial), np.hypot(*(trial[d] for d in TANGENTS))
        return trial[self.direction] * np.divide(limit, size, out=np.ones_like(size), where=size > limit)

    def evaluate(self, motion: Motion) -> Response:
        limit, (trial, size) = self.limit(motion.force), self.try_stick(motion)
        felt = find_felt(limit)
        limit = np.where(felt, limit, 0.0)
        slips = size >= limit
        cone = np.where(slips & felt, self.friction, 0.0)
        return self.respond(motion, trial, size, np.minimum(size, limit), np.where(slips, 0.0, 1.0), cone)

    def try_stick(self, motion: Motion) -> tuple[dict[str, RealArray], RealArray]:
        """Components and size ``(n_t, K)`` of the force that would make the pair stick [N]."""
        trial = {d: motion.force[d] - motion.velocity[d] / self.rho for d in TANGENTS}
        return trial, np.hypot(*trial.values())

    def respond(
        self,
        motion: Motion,
        trial: dict[str, RealArray],
        size: RealArray,
        shrunk: RealArray,
        by_size: RealArray,
        by_normal: RealArray,
    ) -> Response:
        """Residual and derivatives where a trial force of ``size`` is shrunk to one of size ``shrunk``.

        ``by_size`` and ``by_normal`` are the derivatives of ``shrunk`` by ``size`` and by the normal force.
        """
        share = np.where(size > 0, shrunk / np.where(size > 0, size, 1.0), by_size)
        toward = {d: trial[d] / np.where(size > 0, size, 1.0) for d in TANGENTS}
        partials = [Partial("force", "normal", -by_normal * toward[self.direction])]
        for d in TANGENTS:
            own = float(d == self.direction)
            # in this form, exact where the pair sticks: rows that stick throughout are told by equal derivatives
            by_trial = share * own + (by_size - share) * toward[d] * toward[self.direction]
            partials += [Partial("force", d, own - by_trial), Partial("velocity", d, by_trial / self.rho)]
        return Response(motion.force[self.direction] - share * trial[self.direction], tuple(partials))

    def fields(self, motion: Motion) -> dict[str, RealArray]:
        trial, size = self.try_stick(motion)
        admitted = self.admit({**motion.force, **trial})
        return {"admissible_friction_force": admitted, "slipping": size >= self.limit(motion.force)}

    def rounded(self, width: float) -> Law:
        return RoundedPlanarCoulomb(self, width)


class RoundedPlanarCoulomb(Rounded):
    """The trial force's size shrunk by ``round_clip`` into a disk of a rounded ``max(0, lam_N)``."""

    def evaluate(self, motion: Motion) -> Response:
        law = self.exact
        cone, opening = round_positive_part(motion.force["normal"], self.width)
        trial, size = law.try_stick(motion)
        shrunk, by_size, by_limit = round_clip(size, law.friction * cone, self.width)
        return law.respond(motion, trial, size, shrunk, by_size, by_limit * law.friction * opening)
