"""What there is to say of a study: a few lines for people, and facts for the summary of a run, ready for JSON."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from ewr_fenicsx.errors import list_few
from ewr_fenicsx.problem.harmonics import FourierBasis
from ewr_fenicsx.solution.contact_state import sample_along_tangents
from ewr_fenicsx.solution.symmetry import find_idle_harmonics
from ewr_fenicsx.solver.weights import went_back

if TYPE_CHECKING:
    from ewr_fenicsx.accuracy.accuracy import AccurateSolution
    from ewr_fenicsx.accuracy.estimates import ErrorEstimate
    from ewr_fenicsx.given import RealArray
    from ewr_fenicsx.problem.contact_problem import ContactProblem
    from ewr_fenicsx.response.response_curve import FrequencyResponse
    from ewr_fenicsx.solution.solution import PeriodicSolution
    from ewr_fenicsx.structure.interface import Interface
    from ewr_fenicsx.wear.wear import WearHistory

ROUND = 256  # samples of a period, looked through for the largest motion
WORN_AWAY = 0.1  # of the thinnest body, from which wear changes what is meshed


def word_remedy(found: AccurateSolution) -> AccurateSolution:
    """The same, with what a scene can do about its limit in place of what a call can."""
    if found.levels and found.estimate.dominating == "modes":  # what the limit kept from being raised
        return replace(found, remedy=f"ask for less, or raise reduction.modes above {found.levels[-1].modes}")
    return replace(found, remedy="ask for less, or give solver.harmonics in place of an accuracy")


def word_stop(history: WearHistory) -> WearHistory:
    """The same, with what a scene can do about where it stopped in place of what a call can."""
    from ewr_fenicsx.wear.cycle_jumps import REMEDY

    if not (history.stopped or "").endswith(REMEDY):
        return history
    remedy = "lower wear.coefficient, or let wear pass as a flow: wear.tolerance = 0.01"
    return replace(history, stopped=history.stopped.removesuffix(REMEDY) + remedy)


def doubt_small_motion(solution: PeriodicSolution, interface: Interface, through: float) -> list[str]:
    """Where motions or wear are too large for nodes that stay opposite each other, and for linear elasticity.

    Of a body that walks they are looked at about their mean, which means nothing: what keeps it from going off decides.

    Args:
        solution: A converged solution.
        interface: Where its pairs are.
        through: Thickness of the thinnest body [m].
    """
    touches = solution.history("normal_force", ROUND).max(axis=0) > 0
    slip, spacing = sample_along_tangents(solution, "slip", ROUND), measure_spacing(interface)
    wave, names = FourierBasis(solution.orders, ROUND), solution.problem.model.outputs
    moved = {name: wave.synthesise(solution.output(name)[:, None]) for name in names}
    if solution.walks_slowly:
        slip = slip - slip.mean(axis=1, keepdims=True)
        moved = {name: motion - motion.mean() for name, motion in moved.items()}
    slid = np.linalg.norm(slip, axis=0).max(axis=0)
    largest = {name: float(np.abs(motion).max()) for name, motion in moved.items()}
    far = np.flatnonzero(touches & (slid > spacing))
    doubts = []
    if far.size:
        k = far[np.argmax(slid[far] / spacing[far])]
        doubts.append(
            f"{far.size} of {slid.size} pairs slide farther than their nodes are apart, pair {k} by "
            f"{1e3 * slid[k]:.3g} mm of {1e3 * spacing[k]:.3g} mm, and would meet others than those opposite; "
            "see loads, damping and units"
        )
    doubts += [
        f"{name} moves by up to {1e3 * size:.3g} mm, a body is only {1e3 * through:.3g} mm thick: linear elasticity "
        "holds for small motions; see loads, damping and units"
        for name, size in largest.items()
        if size > through
    ]
    deepest = 0.0 if solution.problem.wear is None else float(solution.problem.wear.max())
    if deepest > WORN_AWAY * through:
        doubts.append(
            f"surfaces recede by up to {1e3 * deepest:.3g} mm as they wear, a body is only {1e3 * through:.3g} mm "
            "thick: gaps widen, and bodies and normals stay as they are meshed; see loads, wear coefficients and cycles"
        )
    return doubts


def measure_spacing(interface: Interface) -> RealArray:
    """Distance from each pair to the nearest one on its flank, infinite where it is alone ``(K_c,)`` [m]."""
    spacing = np.full(interface.area.size, np.inf)
    for flank in range(len(interface.flanks)):
        mine = np.flatnonzero(interface.flank_of_pair == flank)
        spacing[mine] = cKDTree(interface.position[mine]).query(interface.position[mine], [2])[0][:, 0]
    return spacing


def list_causes(estimate: ErrorEstimate) -> dict[str, float | None]:
    """Estimated errors by cause, and in all; those that were not looked at, or are not known, are null."""
    causes = {"total": estimate.total} | asdict(estimate)
    return {name: _tell_known(error) for name, error in causes.items()}


def _tell_known(error: float) -> float | None:
    """An estimated error, or null, for JSON has no infinities."""
    return float(error) if np.isfinite(error) else None


def tell_estimate(estimate: ErrorEstimate, what: str) -> str:
    """How far off ``what`` is thought to be of a solution that no accuracy was asked of.

    The mesh is not in it: its error, often the largest, shows only on another mesh.
    """
    remedy = "solver.accuracy = 0.01 takes as many harmonics and modes as that needs"
    return f"  {estimate.tell(f'{what}, that of the mesh aside,', remedy)}"


def list_accuracy(found: AccurateSolution) -> dict[str, object]:
    """What came of an accuracy that was asked for; causes that were not looked at are null."""
    estimate = list_causes(found.estimate)
    limit = found.limit and f"{found.limit}; {found.remedy}"
    return {"asked": found.accuracy, "reached": found.reached, "limit": limit, "estimate": estimate}


def tell_sweep(curve: FrequencyResponse, problem: ContactProblem) -> list[str]:
    """What a curve of solutions of a problem holds, and what it lacks."""
    idle = find_idle_harmonics(problem)
    lines = [f"{len(curve.solutions)} solutions from {curve.frequencies[0]:g} to {curve.frequencies[-1]:g} Hz"]
    lines += [f"  harmonics {', '.join(map(str, idle.orders))} left out: {idle.why}"] if idle.orders else []
    lines += _tell_accuracy(curve) if curve.accurate else []
    lost = int(curve.unstable.sum())
    lines += (
        [f"  {lost} of them {'is' if lost == 1 else 'are'} unstable: no motion in time stays there"] if lost else []
    )
    usual = count_default_weights(curve, problem)
    lines += [f"  {usual} of them hold with default weights and dashpots: others led nowhere"] if usual else []
    lines += [f"  no solution at {list_few(curve.missing, 'frequencies')} Hz"] if curve.missing else []
    return lines + [f"  jump from {j.frequency[0]:g} to {j.frequency[1]:g} Hz: {j.why}" for j in curve.jumps]


def _tell_accuracy(curve: FrequencyResponse) -> list[str]:
    """How accurate the solutions of a curve are thought to be, and why some are not as accurate as asked."""
    asked, worst = curve.accurate[0].accuracy, max(found.estimate.total for found in curve.accurate)
    tops = [s.orders[-1] for s in curve.solutions]
    solves = sum(len(found.levels) for found in curve.accurate)
    lines = [
        f"  estimated errors up to {worst:.1g} of {asked:g} asked, highest harmonics {min(tops)} to {max(tops)}, "
        f"{solves} solves besides those of the curve"
    ]
    reasons: dict[str, list[AccurateSolution]] = {}
    for found in curve.accurate:
        if not found.reached:
            reasons.setdefault(f"{found.limit}; {found.remedy}", []).append(found)
    for why, short in reasons.items():
        where = list_few([found.solution.problem.frequency for found in short], "solutions")
        error = max(found.estimate.total for found in short)
        lines.append(f"  NOT as accurate as asked at {where} Hz: up to {error:.1g}; {why}")
    return lines


def count_default_weights(curve: FrequencyResponse, problem: ContactProblem) -> int:
    """How many solutions of a curve have default weights and dashpots in place of what the problem asks for."""
    return 0 if went_back(problem) else sum(went_back(s.problem) for s in curve.solutions)


def list_facts_of_sweep(curve: FrequencyResponse, problem: ContactProblem) -> dict[str, object]:
    """What decides whether to trust a curve: breaks and gaps, accuracy."""
    facts: dict[str, object] = {
        "sweep": {
            "solutions": len(curve.solutions),
            "unstable": int(curve.unstable.sum()),
            "with_default_weights": count_default_weights(curve, problem),
            "missing_Hz": list(curve.missing),
            "jumps": [{"from_Hz": j.frequency[0], "to_Hz": j.frequency[1], "why": j.why} for j in curve.jumps],
        }
    }
    if curve.accurate:
        short = [{"frequency_Hz": f.solution.problem.frequency} | list_accuracy(f) for f in curve.accurate]
        short = [found for found in short if not found["reached"]]
        worst = _tell_known(max(found.estimate.total for found in curve.accurate))
        asked = curve.accurate[0].accuracy
        facts["accuracy"] = {"asked": asked, "reached": not short, "estimate": {"total": worst}, "short": short}
    return facts


def tell_wear(history: WearHistory, through: float, modes: int) -> list[str]:
    """How deep a joint has worn, how accurate that is thought to be, and why it is no result where it is none.

    Args:
        history: The wear.
        through: Thickness of the thinnest body [m].
        modes: Modes that the reduced model keeps.
    """
    lines = history.list_outcome()
    if history.accuracy is not None:
        tops, worst = [s.orders[-1] for s in history.solutions], np.nanmax(history.estimates)
        told = (
            f"  estimated errors up to {worst:.1g} of {history.accuracy:g} asked, highest harmonics "
            f"{min(tops)} to {max(tops)}, {modes} modes"
        )
        lines.insert(1, told)
    if history.depth[-1].max() > through:
        lines.append(f"  NOT a result: a body is only {through:.3g} m thick; see wear.coefficient, loads and units")
    return lines + [f"  the first solve: {line}" for line in history.solutions[0].list_reservations()]


def list_facts_of_wear(history: WearHistory) -> dict[str, object]:
    """What decides whether to trust a history: why it stopped, when it lost its stability, accuracy, first solve."""
    reservations = history.solutions[0].list_reservations()
    facts: dict[str, object] = {
        "wear": {
            "cycles": int(history.cycles[-1]),
            "solves": history.solves,
            "stopped": history.stopped,
            "rough_cycles": history.rough,
            "leaps": [asdict(leap) for leap in history.leaps],
            "loss_of_stability_after_cycles": history.loss_of_stability,
            "reservations_of_first_solve": reservations,
        }
    }
    if history.accuracy is not None:
        facts["accuracy"] = {
            "asked": history.accuracy,
            "reached": not history.short.size,
            "estimate": {"total": _tell_known(np.nanmax(history.estimates))},
            "short_after_cycles": history.short.tolist(),
        }
    return facts
