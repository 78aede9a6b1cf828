"""Coulomb's cone: the limit of dry friction, and the nearest force within it.

Source: Alart & Curnier (1991), doi:10.1016/0045-7825(91)90022-X.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass

import numpy as np

from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.laws.law_kinds import Law

ROUNDING = 1e-14  # share of the largest limit, up to which one is none


@dataclass(frozen=True, eq=False)
class FrictionLaw(Law):
    """Dry friction, whatever closes its truncation; along one line, unless a law says otherwise.

    Args:
        pairs: ``(K,)`` pairs governed.
        friction: ``(K,)`` coefficients of friction ``mu``.
        static_row, static_force_row: ``(1, eps)`` keeps the mean equation, regularised; ``(0, 1)`` sets mean friction
            to zero.
        static_displacement_row: ``(K,)`` or scalar; positive where only friction holds a body: pairs that stick
            throughout then share its mean load like springs [N/m].
        direction: The contact direction that the law owns.
    """

    pairs: np.ndarray
    friction: RealArray
    _: KW_ONLY
    static_row: float = 1.0
    static_force_row: float | RealArray = 0.0
    static_displacement_row: float | RealArray = 0.0
    direction: str = "tangential"
    opposes = "velocity"

    @property
    def static_target(self) -> RealArray | None:
        """Where a spring alone decides the mean force, the place to which it holds the pair: that without loads."""
        held = np.asarray(self.static_displacement_row) > 0
        return np.zeros(self.pairs.size) if np.all(held & (np.asarray(self.static_force_row) == 0)) else None

    def limit(self, force: Mapping[str, RealArray]) -> RealArray:
        """``mu max(0, lam_N)`` under forces direction -> ``(n_t, K)`` [N]."""
        return self.friction * np.maximum(0.0, force["normal"])

    def admit(self, trial: Mapping[str, RealArray]) -> RealArray:
        return project_on_cone(trial["tangential"], self.limit(trial))


def find_felt(limit: RealArray) -> np.ndarray:
    """Where a limit is more than rounding beside the largest one of the law's pairs, ``(n_t, K)`` bool.

    The normal force of a pair that stays open is zero but for rounding, which would press it now and then: derivatives
    of its friction would change from sample to sample, and rows whose derivatives do not are free of cost. The forces
    that meet a limit tell nothing of that: next to a mode without damping any limit is rounding beside them, and bounds
    the motion all the same.

    Args:
        limit: ``mu max(0, lam_N)``, ``(n_t, K)`` [N].
    """
    return limit > ROUNDING * np.max(limit, initial=0.0)


def project_on_cone(force: RealArray, limit: RealArray) -> RealArray:
    """Nearest friction force within the Coulomb limit, sample by sample.

    Args:
        force: Trial friction force, ``(n_t, K)`` [N].
        limit: ``mu max(0, lam_N)``, ``(n_t, K)`` [N].

    Returns:
        Admissible friction force, ``(n_t, K)`` [N].

    Raises:
        ModelError: A limit is negative or NaN; names the first sample and pair.
    """
    if not limit.min(initial=0.0) >= 0:
        sample, pair = np.argwhere(~(limit >= 0))[0]
        raise ModelError(
            f"friction limit {limit[sample, pair]} N at sample {sample} of pair {pair}; it must not be negative"
        )
    return np.minimum(np.maximum(force, -limit), limit)
