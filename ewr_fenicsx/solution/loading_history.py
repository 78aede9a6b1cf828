"""Mean friction: whether a solution depends on how its loads came, or lacks what would act where it is set to zero.

The laws have a family of steady states where pairs stick throughout. ``static_friction = "resolved"`` takes the one
with the least mean friction, ``"held"`` the one that a slow loading from rest leads to (``mean_friction.py``). Whether
the two differ is seen from one Newton step from the one towards the other. Of pairs that slip the laws know the mean,
which ``"zero"`` leaves out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.balance.periodic_motion import PeriodicMotion
from ewr_fenicsx.errors import name_pairs
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.laws.cone import FrictionLaw
from ewr_fenicsx.problem.contact_problem import ContactProblem

# Mean friction over its limit, and what it changes of a pair's mean force over what that can be, from where on the
# history of the loads is worth a word; and the share of the largest such force that is compared with at least
CARRIED, CHANGED, FAINT = 0.05, 0.05, 0.1
MISSED = 0.02  # mean friction that is set to zero, over what oscillates, from where on it is worth a word


def tell_history(motion: PeriodicMotion) -> list[str]:
    """A line where pairs that never slip may carry friction on average that would decide about others, or at rest."""
    problem, (balance, unknowns) = motion.problem, motion.pose()
    stuck, limit = find_stuck(balance, motion)
    if not (balance.basis.has_mean and stuck.size):
        return []
    held = HarmonicBalance(hold_in_place(problem).system, balance.force_unit)
    try:
        step = held.linearise(unknowns)
        change = held.unpack(step.solve(step.residual))[0][0].real
    except np.linalg.LinAlgError:
        return []
    at_pairs, none = problem.system.spread, np.zeros(problem.model.pairs)
    friction = np.hypot.reduce([none, *(at_pairs(change, d) for d in problem.model.tangent_directions)])
    carried = stuck[friction[stuck] > CARRIED * limit]
    normal = at_pairs(motion.forces[0].real, "normal") + problem.given_force.get(0, none).real
    limits = problem.friction * np.maximum(0.0, normal)
    limits[stuck] = 0.0
    presses, slides = _matters(at_pairs(change, "normal"), normal), _matters(friction * (limits > 0), limits)
    if not carried.size or not (presses or slides or not problem.frequency):
        return []
    what = "normal forces" if presses else "how others slide" if slides else "where they rest"
    return [
        f"friction holds {name_pairs(carried)} throughout: what it carries there on average, and with it {what}, "
        'depends on how the loads came; this is the state with the least of it, static_friction = "held" the one after '
        "a slow loading from rest"
    ]


def tell_missed_mean(motion: PeriodicMotion) -> list[str]:
    """A line where pairs that slip lack a mean friction that is worth a word."""
    if not (missed := find_missed_mean(motion)):
        return []
    return [
        f'static_friction = "zero" leaves out a mean of {missed:.0%} of the oscillation, which friction that slips '
        'would have: what closes the truncation then matters, however many harmonics are kept; "resolved" has that mean'
    ]


def find_missed_mean(motion: PeriodicMotion) -> float:
    """Mean friction that pairs that slip lack where it is set to zero, over its oscillation; 0 where it is little."""
    missed, swings, basis = 0.0, 0.0, motion.problem.basis
    if not basis.has_mean or all(law.static_row for law in motion.problem.system.laws):
        return 0.0
    for law, seen in motion.law_fields(basis):
        if isinstance(law, FrictionLaw) and not law.static_row:
            force = seen["admissible_friction_force"][:, seen["slipping"].any(axis=0)]
            missed, swings = np.hypot(missed, np.linalg.norm(force.mean(axis=0))), swings + force.var(axis=0).sum()
    return float(missed / np.sqrt(swings)) if missed > MISSED * np.sqrt(swings) else 0.0


def _matters(change: RealArray, force: RealArray) -> bool:
    """Whether changes are worth a word beside the forces that change, or the larger ones of other pairs, ``(K,)``."""
    size = np.abs(force)
    return bool(np.any(np.abs(change) > CHANGED * np.maximum(size, FAINT * size.max(initial=0.0))))


def find_stuck(balance: HarmonicBalance, motion: PeriodicMotion) -> tuple[np.ndarray, RealArray]:
    """Pairs with friction that never slip, whose mean friction is resolved, and the least limit of each [N]."""
    stuck, limits = [], []
    seen = balance.sample(motion.forces, motion.row_motion)
    for law, rows, at in zip(balance.system.laws, balance.law_rows, seen, strict=True):
        resolved = np.all(balance.static_row[rows] > 0) and not np.any(balance.held[rows])
        if isinstance(law, FrictionLaw) and law.direction == "tangential" and resolved:
            least = law.limit(at.force).min(axis=0)
            sticks = ~np.any(law.fields(at)["slipping"], axis=0) & (least > 0)
            stuck.append(law.pairs[sticks])
            limits.append(least[sticks])
    pairs, limit = (np.concatenate([np.zeros(0, dtype=kind), *x]) for kind, x in ((int, stuck), (float, limits)))
    order = np.argsort(pairs)
    return pairs[order], limit[order]


def hold_in_place(problem: ContactProblem) -> ContactProblem:
    """The problem with friction that holds its pairs where they are without loads, but for such as has no mean."""
    groups = [
        (pairs, laws if laws.static_friction == "zero" else replace(laws, static_friction="held"))
        for pairs, laws in problem.groups
    ]
    return replace(problem, laws=groups)
