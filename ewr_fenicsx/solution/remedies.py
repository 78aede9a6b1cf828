"""What a user may try where no periodic solution was found."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from scipy.optimize import linprog

from ewr_fenicsx.errors import name_pairs
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.problem.composition import list_unpressed
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.solution.solution import PeriodicSolution, tell_hit

# Residual that rounding leaves, where it is in the way of usual tolerances; and times that, what it may explain
COARSE, ROUNDING = 1e-10, 10.0
LARGEST = 2000  # contact rows of which it is looked whether they depend on one another: a second
INVOLVED = 1e-6  # share of a row in what is dependent, above which it is one of those
OVERLAP = 1e-6  # over the largest gap, below which what no motion relieves may be rounding
FILLED = 10**5  # entries of rows, none of them zero, that a linear program takes half a second for
INDEPENDENT = 1e-10  # least eigenvalue of unit rows' products with one another, above which none depends on others


def list_remedies(best: PeriodicSolution) -> str:
    """What a user may try where every way failed, and left this."""
    problem, residual = best.problem, best.residual
    left = estimate_rounding(problem)
    if left > COARSE and residual < ROUNDING * left:
        return (
            f". At {problem.frequency:g} Hz floating bodies move by far more than they deform, and rounding alone "
            f"leaves a residual of {left:.0e}. Raise the frequency: well below the first mode it changes nothing but "
            "this; or allow a larger tolerance"
        )
    own = ", ".join(problem.own_kinds)
    if own and not np.isfinite(residual):
        return f". Laws return infinities or NaN: look at {own}"
    hit = best.list_hit_modes() or list_modes_lost_in_rounding(best)
    if hit:
        return f". {hit[0].capitalize()}"
    if jammed := find_jammed_pairs(problem):
        return (
            f". No motion relieves the interferences of {name_pairs(jammed)} together: wherever the bodies are, some "
            "of these overlap. Make them smaller, or give each pair a surface of its own, a massless coordinate behind "
            "a stiff spring"
        )
    if loose := list_unpressed(problem, problem.system):
        return (
            f". Nothing presses {name_pairs(loose)}: no equilibrium has a mean force there, so none acts at any time, "
            "and the bodies that float on them may lie anywhere. Give each a mean load that presses it, as its weight "
            "or rotation does, or hold it by a spring or a support"
        )
    if alike := find_dependent_pairs(problem):
        return (
            f". The rows of {name_pairs(alike)} depend on one another: how they share forces is open where they stick. "
            "Make them one pair, or give each a surface of its own, a massless coordinate behind a stiff spring"
        )
    if not problem.frequency and not own:
        resolved = any(laws.static_friction != "held" for _, laws in problem.groups)
        held = 'static_friction = "held", which says how the loads came, or ' if resolved else ""
        return f". Try {held}a little more friction"
    stepped = "integrate(...) on unroll_ring(model)" if problem.model.cyclic else "integrate(problem)"
    last = f"{stepped} shows whether the motion becomes periodic at all"
    if own:
        last = f"look at the derivatives of {own}, and at its corners (rounded): docs/adding_a_law.md"
    return (
        ". Try fewer harmonics or more, a neighbouring solution as start= (in a scene: a sweep that ends here), or "
        f"more damping; {last}"
    )


def estimate_rounding(problem: ContactProblem) -> float:
    """Residual that the rounding of forces leaves, by the motion that they cause over the deformation that counts."""
    if problem.model.rigid_modes.shape[1] == 0 or problem.frequency == 0:
        return 0.0
    return float(_measure_rounding(problem).max())


def _measure_rounding(problem: ContactProblem) -> RealArray:
    """``(n_h,)`` the same at each harmonic, whatever holds the bodies."""
    moved, deformed = problem.system.compliance.flexibility, problem.system.flexibility
    return np.finfo(float).eps * np.abs(moved).max(axis=(1, 2), initial=0.0) / deformed.min(initial=np.inf)


def list_modes_lost_in_rounding(best: PeriodicSolution) -> list[str]:
    """The harmonic next to a mode without damping where the rounding of forces alone leaves what is left.

    Behind the springs of a contact node, which take forces of their own, ``list_hit_modes`` does not see it.
    """
    left = np.where(np.array(best.orders) == 0, 0.0, _measure_rounding(best.problem))  # the mean: ``estimate_rounding``
    if not (left.max() > COARSE and best.residual < ROUNDING * left.max()):
        return []
    return [tell_hit(best.orders[int(np.argmax(left))])]


def find_jammed_pairs(problem: ContactProblem) -> list[int]:
    """Pairs that no mean motion brings apart all at once, as interferences of more pairs than bodies can give way to.

    A linear program finds the motion that leaves the least overlap. Its multipliers prove it: weights, none of them
    negative, with which the motions of these pairs cancel, and their gaps add up to less than none. None where that
    would take long.
    """
    pairs = np.array([k for some, laws in problem.groups if laws.normal == "unilateral" for k in some], dtype=int)
    if pairs.size > LARGEST or not np.any(problem.clearance[pairs] < 0):
        return []
    rows = problem.layout.rows_in(0)[problem.layout.row_of("normal", pairs)]
    sizes = np.linalg.norm(rows, axis=1)
    if not np.all(sizes > 0) or np.count_nonzero(rows) > FILLED:
        return []
    rows, gaps = rows / sizes[:, None], problem.clearance[pairs] / sizes
    if pairs.size <= rows.shape[1] and np.linalg.eigvalsh(rows @ rows.T)[0] > INDEPENDENT:  # each gives way by itself
        return []
    least = linprog(  # motion over the largest gap, and by how much pairs overlap at least
        np.arange(rows.shape[1] + 1) == rows.shape[1],
        A_ub=np.hstack([-rows, -np.ones((pairs.size, 1))]),
        b_ub=gaps / np.abs(gaps).max(),
        bounds=(None, None),
        method="highs",
    )
    if least.status != 0 or not least.fun > OVERLAP:
        return []
    return sorted(pairs[-least.ineqlin.marginals > INVOLVED].tolist())


def find_dependent_pairs(problem: ContactProblem) -> list[int]:
    """Pairs whose contact rows are linear combinations of one another's; none where there are too many to look."""
    system = problem.system
    rows = system.rows_in(system.usual_wave)
    sizes = np.linalg.norm(rows, axis=1, keepdims=True)
    if not 0 < len(rows) <= LARGEST or not np.all(sizes > 0):
        return []
    dependent = scipy.linalg.null_space((rows / sizes).conj().T)
    involved = np.abs(dependent).max(axis=1, initial=0.0) > INVOLVED
    return np.flatnonzero(np.any([system.spread(involved, d) for d in system.index], axis=0)).tolist()
