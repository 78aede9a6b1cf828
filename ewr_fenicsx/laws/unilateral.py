"""Unilateral contact (Signorini): bodies press and part, but neither pull nor penetrate.

Source: the equality-based form of the projections of Alart & Curnier (1991), doi:10.1016/0045-7825(91)90022-X.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.laws.law_kinds import Law, LawKind, MeanBound, Motion, PairGroup, Partial, Response, register_law
from ewr_fenicsx.laws.smoothing import Rounded, round_positive_part


@register_law("normal", "unilateral")
@dataclass(frozen=True, eq=False)
class Unilateral(LawKind):
    """Contact that opens.

    Args:
        initial_gap: Clearance [m], scalar or ``(K,)``; negative: interference.
    """

    initial_gap: float | RealArray = 0.0
    histories = ("normal_force", "gap")
    opens = only_pushes = True
    effect = "separation"

    def acts_in(self, tangents: int) -> tuple[str, ...]:
        return ("normal",)

    def bound_mean(self, spread) -> MeanBound:
        return MeanBound(0.0, np.inf)

    def build(self, group: PairGroup) -> tuple[Law, ...]:
        return (Signorini(group.pairs, group.clearance, group.weight["normal"]),)


@dataclass(frozen=True, eq=False)
class Signorini(Law):
    """``lam_N + min(0, rho (q_N + g_0) - lam_N) = 0``.

    Args:
        pairs: ``(K,)`` pairs governed.
        initial_gap: ``(K,)`` initial clearance plus wear ``g_0`` [m].
        rho: ``(K,)`` positive weight [N/m].
    """

    pairs: np.ndarray
    initial_gap: RealArray
    rho: RealArray
    direction: str = "normal"
    opposes = "displacement"
    has_corners = True

    @property
    def static_target(self) -> RealArray:
        return -self.initial_gap

    @property
    def impedance(self) -> RealArray:
        return self.rho

    def admit(self, trial: Mapping[str, RealArray]) -> RealArray:
        return np.maximum(0.0, trial["normal"])

    def evaluate(self, motion: Motion) -> Response:
        force = motion.force["normal"]
        pressed = self.rho * (motion.displacement["normal"] + self.initial_gap)
        closed = pressed < force
        return Response(np.where(closed, pressed, force), self.differentiate((closed,)))

    def try_closed(self, motion: Motion) -> RealArray:
        """Force ``lam_N - rho g``, ``(n_t, K)``, under which the pair is closed where it presses [N]."""
        return motion.force["normal"] - self.rho * (motion.displacement["normal"] + self.initial_gap)

    def find_corners(self, motion: Motion) -> tuple[RealArray]:
        return (self.try_closed(motion),)

    def differentiate(self, sides: Sequence[np.ndarray]) -> tuple[Partial, ...]:
        (closed,) = sides
        return (
            Partial("force", "normal", np.where(closed, 0.0, 1.0)),
            Partial("displacement", "normal", np.where(closed, self.rho, 0.0)),
        )

    def fields(self, motion: Motion) -> dict[str, RealArray]:
        pressing = np.maximum(0.0, self.try_closed(motion))
        return {"admissible_normal_force": pressing, "open": pressing <= 0}

    def rounded(self, width: float) -> Law:
        return RoundedSignorini(self, width)


class RoundedSignorini(Rounded):
    """``lam_N - max(0, lam_N - rho g) = 0``, rounded."""

    def evaluate(self, motion: Motion) -> Response:
        law, force = self.exact, motion.force["normal"]
        value, slope = round_positive_part(law.try_closed(motion), self.width)
        return Response(
            force - value,
            (Partial("force", "normal", 1 - slope), Partial("displacement", "normal", law.rho * slope)),
        )
