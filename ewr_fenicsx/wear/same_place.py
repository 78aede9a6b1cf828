"""Pairs at one place, such as two pads under a rigid block: they wear level, and from then on as one.

What they carry together is all that equilibrium knows. The highest one carries it alone and wears till it is level with
the next; so cycle by cycle they would take turns, however long jumps might be, and next to level is what solves take
longest for. Level is what the depth that was worn by all of them makes it, whoever wore it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.problem.contact_problem import ContactProblem


class PairsAtOnePlace:
    """The groups of pairs that move alike, and how they wear level.

    Args:
        problem: The joint at the start.
        coefficient: ``(K_c,)`` wear coefficients [1/Pa].
    """

    def __init__(self, problem: ContactProblem, coefficient: RealArray):
        self.clearance, self.coefficient, self.areas = problem.clearance, coefficient, problem.model.areas
        self.start = np.zeros(coefficient.size) if problem.wear is None else np.array(problem.wear)
        self.groups = [pairs for pairs in _find_alike(problem) if np.any(coefficient[pairs] > 0)]

    def level(self, depth: RealArray) -> RealArray:
        """Depths ``(K_c,)`` [m] of as much wear, level at each place; what does not wear ends it."""
        if not self.groups:
            return depth
        levelled = np.array(depth)
        for pairs in self.groups:
            wears = self.coefficient[pairs] > 0
            mine, stays = pairs[wears], pairs[~wears]
            share = self.areas[mine] / self.coefficient[mine]  # of a load on its way, that a depth takes
            order = np.argsort(self.clearance[mine], kind="stable")
            high, share = self.clearance[mine][order], share[order]
            worn = share @ np.maximum(0.0, depth[mine] - self.start[mine])[order]
            # the lowest clearance up to which the first ones have worn, so that it is not yet the next one's
            ends = (worn + np.cumsum(share * high)) / np.cumsum(share)
            reached = int(np.flatnonzero(ends <= np.append(high[1:], np.inf))[0])
            end = min(ends[reached], self.clearance[stays].min(initial=np.inf))
            levelled[mine] = self.start[mine] + np.maximum(0.0, end - self.clearance[mine])
        return levelled

    def level_rate(self, depth: RealArray, rate: RealArray) -> RealArray:
        """What a cycle wears ``(K_c,)`` [m] that wears level; depths are."""
        return np.maximum(0.0, self.level(depth + rate) - depth) if self.groups else rate


def _find_alike(problem: ContactProblem) -> Sequence[np.ndarray]:
    """Pairs that may part, and that all motions of the model move alike, in groups of two or more.

    Where laws give way by themselves, they share a load without being level.
    """
    model, cyclic, system = problem.model, problem.model.cyclic, problem.system
    opens = np.flatnonzero(problem.opens)
    opens = opens[system.stick_flexibility[system.row_of("normal", opens)] == 0]
    rows = [model.normal, model.tangential]
    if cyclic is not None:
        rows += [cyclic.normal, cyclic.tangential]
    of_pair = np.hstack([row.reshape(model.pairs, -1) for row in rows if row is not None]) + 0.0  # -0 is 0
    alike: dict[bytes, list[int]] = {}
    for pair in opens:
        alike.setdefault(of_pair[pair].tobytes(), []).append(pair)
    return [np.array(pairs) for pairs in alike.values() if len(pairs) > 1]
