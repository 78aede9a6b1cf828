"""Bonded contact: no relative motion. It costs no unknown, and takes its motions out of the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ewr_fenicsx.given import RealArray
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


@register_law("normal", "bonded")
@dataclass(frozen=True, eq=False)
class BondedNormal(LawKind):
    """Neither gap nor penetration, whatever the force."""

    histories = ("normal_force",)
    effect = "bonded parts"
    odd = blind_to_mean = True

    def holds(self, tangents: int) -> tuple[str, ...]:
        return ("normal",)

    def bound_mean(self, spread) -> MeanBound:
        return MeanBound(-np.inf, np.inf)

    def build(self, group: PairGroup) -> tuple[Law, ...]:
        if "normal" not in group.flexibility:
            return ()
        return (Bond(group.pairs, 1 / group.flexibility["normal"]),)  # friction must know the force


@register_law("tangential", "bonded")
@dataclass(frozen=True, eq=False)
class BondedTangential(LawKind):
    """No slip, whatever the force."""

    histories = ("friction_force",)
    effect = "bonded parts"
    odd = blind_to_mean = True

    def holds(self, tangents: int) -> tuple[str, ...]:
        return TANGENTS[:tangents]


@dataclass(frozen=True, eq=False)
class Bond(Law):
    """No normal motion whatever the force, ``rho q_N = 0``: used where friction must know the force that bonds.

    Args:
        pairs: ``(K,)`` pairs governed.
        rho: ``(K,)`` positive weight [N/m].
    """

    pairs: np.ndarray
    rho: RealArray
    direction: str = "normal"
    linear: bool = True
    opposes = "displacement"

    @property
    def static_target(self) -> RealArray:
        return np.zeros(self.pairs.size)

    def admit(self, trial: Mapping[str, RealArray]) -> RealArray:
        return trial["normal"]

    def evaluate(self, motion: Motion) -> Response:
        displacement = motion.displacement["normal"]
        stiffness = np.broadcast_to(self.rho, displacement.shape)
        return Response(stiffness * displacement, (Partial("displacement", "normal", stiffness),))
