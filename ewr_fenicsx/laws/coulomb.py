"""Coulomb's dry friction along one line, with the true, varying cone; and the frictionless limit.

Pairs with two tangents get the law in a plane, ``planar_coulomb.py``.

Source: the equality-based form of the projections of Alart & Curnier (1991), doi:10.1016/0045-7825(91)90022-X.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.laws.cone import FrictionLaw, find_felt, project_on_cone
from ewr_fenicsx.laws.inertial_coulomb import InertialCoulomb
from ewr_fenicsx.laws.law_kinds import (
    TANGENTS,
    Law,
    LawKind,
    MeanBound,
    Motion,
    PairGroup,
    Partial,
    Response,
    register_law,
)
from ewr_fenicsx.laws.mean_friction import StaticFriction, choose_mean_equation
from ewr_fenicsx.laws.planar_coulomb import build_in_plane
from ewr_fenicsx.laws.smoothing import Rounded, round_clip, round_positive_part
from ewr_fenicsx.laws.sprung_coulomb import SprungCoulomb


@register_law("tangential", "coulomb")
@dataclass(frozen=True, eq=False)
class DryFriction(LawKind):
    """Friction under the normal force of the same pair.

    Args:
        friction: Coefficient, scalar or ``(K,)``.
        static_friction: What decides the mean friction force: ``"resolved"``, ``"held"`` or ``"zero"``.
    """

    friction: float | RealArray = 0.2
    static_friction: StaticFriction = "resolved"
    histories = ("friction_force", "admissible_friction_force", "slip", "slip_velocity")
    needs = ("normal",)
    effect = "friction"
    odd = blind_to_mean = rests = True

    def acts_in(self, tangents: int) -> tuple[str, ...]:
        return TANGENTS[: max(1, tangents)]

    def bound_mean(self, spread) -> MeanBound:
        return MeanBound(0.0, 0.0, 0.0 if self.static_friction == "zero" else spread(self.friction))

    def build(self, group: PairGroup) -> tuple[Law, ...]:
        if "tangential" not in group.weight:  # the pairs rest
            return ()
        mean, friction = choose_mean_equation(group, self.static_friction), group.spread(self.friction)
        if "second_tangential" in group.weight:
            return build_in_plane(group, friction, mean)
        closing, masses = group.closing["tangential"], group.closing_mass["tangential"]
        if self.static_friction == "zero":  # nothing would keep a mass's own surface from sliding off
            masses = np.zeros_like(masses)
        closures = (
            (Coulomb, group.weight["tangential"], (closing <= 0) & (masses <= 0)),
            (SprungCoulomb, closing, closing > 0),
            (partial(InertialCoulomb, period=group.period), masses, masses > 0),
        )
        laws = []
        for kind, given, picked in closures:
            if np.any(picked):
                laws.append(kind(group.pairs[picked], friction[picked], given[picked], **mean.of(picked)._asdict()))
        return tuple(laws)


@register_law("tangential", "frictionless")
@dataclass(frozen=True, eq=False)
class Frictionless(LawKind):
    """Slip without a force: nothing to solve for."""

    histories = ("slip", "slip_velocity")
    slides = odd = blind_to_mean = True
    effect = "frictionless flanks"


@dataclass(frozen=True, eq=False)
class Coulomb(FrictionLaw):
    """Dry friction in one tangential direction with the true, varying cone.

    ``lam_T - clip(lam_T - v / rho, -mu c, mu c) = 0`` with ``c = max(0, lam_N)``: the velocity-level
    dynamic-Lagrangian frequency-time method with penalty ``1 / rho``.

    Args:
        rho: ``(K,)`` positive weight [(m/s)/N].
    """

    rho: RealArray
    has_corners = True

    @property
    def impedance(self) -> RealArray:
        return 1 / self.rho

    def evaluate(self, motion: Motion) -> Response:
        limit, trial = self.limit(motion.force), self.try_stick(motion)
        sides = find_felt(limit), trial >= limit, trial > -limit
        return Response(motion.force["tangential"] - project_on_cone(trial, limit), self.differentiate(sides))

    def try_stick(self, motion: Motion) -> RealArray:
        """Force ``(n_t, K)`` that would make the pair stick [N]."""
        return motion.force["tangential"] - motion.velocity["tangential"] / self.rho

    def find_corners(self, motion: Motion) -> tuple[RealArray, ...]:
        normal, trial = motion.force["normal"], self.try_stick(motion)
        return normal, trial - self.friction * normal, trial + self.friction * normal

    def differentiate(self, sides: Sequence[np.ndarray]) -> tuple[Partial, ...]:
        pressed, forward, ahead_of_backward = sides
        sticks = pressed & ~forward & ahead_of_backward
        cone = np.where(forward, -self.friction, self.friction)
        return (
            Partial("force", "tangential", np.where(sticks, 0.0, 1.0)),
            Partial("velocity", "tangential", np.where(sticks, 1 / self.rho, 0.0)),
            Partial("force", "normal", np.where(pressed & ~sticks, cone, 0.0)),
        )

    def fields(self, motion: Motion) -> dict[str, RealArray]:
        limit, trial = self.limit(motion.force), self.try_stick(motion)
        return {"admissible_friction_force": project_on_cone(trial, limit), "slipping": np.abs(trial) >= limit}

    def rounded(self, width: float) -> Law:
        return RoundedCoulomb(self, width)


class RoundedCoulomb(Rounded):
    """``lam_T - clip(lam_T - v / rho, -mu c, mu c) = 0`` with ``c = max(0, lam_N)``, both rounded."""

    def evaluate(self, motion: Motion) -> Response:
        law = self.exact
        cone, opening = round_positive_part(motion.force["normal"], self.width)
        value, by_trial, by_limit = round_clip(law.try_stick(motion), law.friction * cone, self.width)
        return Response(
            motion.force["tangential"] - value,
            (
                Partial("force", "tangential", 1 - by_trial),
                Partial("velocity", "tangential", by_trial / law.rho),
                Partial("force", "normal", -by_limit * law.friction * opening),
            ),
        )
