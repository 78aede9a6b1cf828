"""What accuracy costs: the knobs of the contact solve turned one at a time, errors against time.

``list_settings`` says which knobs there are, ``survey`` solves and compares, ``find_front`` and ``fit_slope`` read the
result. The reference is any ``Figures``: of time stepping, or of a harmonic solve with more of everything.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import median

import numpy as np

from ewr_fenicsx.accuracy.estimates import read_response
from ewr_fenicsx.accuracy.looking_ahead import choose_samples
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.problem.dashpots import read_friction_weight, read_weight, use_mobility
from ewr_fenicsx.solution.contact_state import sample_along_tangents
from ewr_fenicsx.solution.indicators import measure_cone_violation, measure_sliding
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solver.newton import solve

SAMPLES = 800  # of the period, for figures that are integrals or maxima
HIGHEST = 63  # harmonic of the outputs that is compared
HIGHEST_VARIANT = 23  # N up to which other weights, samples and sets of harmonics are tried; springs at all
LOOSE = 1e-4  # tolerance of the solver that is enough for errors of a per mille


@dataclass(frozen=True, eq=False)
class Figures:
    """What of a periodic motion is compared.

    Attributes:
        output: ``(HIGHEST, p)`` complex amplitudes of the outputs from harmonic 1 on [m]; without outputs, as
            ``read_response`` has them, those of all contact rows as one, ``(HIGHEST 2 m, 1)``.
        sliding: ``(K_c,)`` distance slid a cycle [m].
        normal_force: ``(SAMPLES, K_c)`` [N].
        wear: ``(K_c,)`` integral of ``p |v|`` over a cycle: what wears, but for its coefficient [Pa m]; of the force in
            place of the pressure where the model has no areas [N m].
        penetration: Largest, over the largest opening or, without any, the largest slip.
        tension: Largest, over the largest normal force.
        cone_violation: Largest, over the largest limit.
    """

    output: ComplexArray
    sliding: RealArray
    normal_force: RealArray
    wear: RealArray
    penetration: float
    tension: float
    cone_violation: float


def measure_figures(motion: PeriodicSolution) -> Figures:
    """Figures of a periodic solution, or of a steady state of ``integrate``: both tell the same histories."""
    problem, area = motion.problem, motion.problem.model.areas
    force, gap = (motion.history(name, SAMPLES) for name in ("normal_force", "gap"))
    friction, slip = (sample_along_tangents(motion, name, SAMPLES) for name in ("friction_force", "slip"))
    speed = motion.sliding_speed(SAMPLES)
    period, pressing, rubs = 1 / problem.frequency, motion.pressing_force(SAMPLES), problem.friction > 0
    largest_slip = np.linalg.norm(np.ptp(slip, axis=1), axis=0).max(initial=0.0)
    opening = max(gap[:, problem.opens].max(initial=0.0), largest_slip) or 1.0
    return Figures(
        output=read_response(motion, range(1, HIGHEST + 1)),
        sliding=measure_sliding(speed, period),
        normal_force=force,
        wear=period * (pressing / area * speed).mean(axis=0),
        penetration=max(0.0, -float(gap[:, problem.opens].min(initial=0.0))) / opening,
        tension=max(0.0, -float(force[:, problem.opens].min(initial=0.0))) / (float(force.max(initial=0.0)) or 1.0),
        cone_violation=measure_cone_violation(
            np.linalg.norm(friction, axis=0)[:, rubs], force[:, rubs], problem.friction[rubs]
        ),
    )


def compare_figures(here: Figures, there: Figures) -> dict[str, float]:
    """Relative errors of ``here`` against the reference ``there``, and violations, by name."""
    off = lambda a, b: float(np.linalg.norm(a - b) / (np.linalg.norm(b) or 1.0))  # noqa: E731
    apart = lambda of: float(abs(of(here) - of(there)) / (abs(of(there)) or 1.0))  # noqa: E731
    # the mean over pairs and the L2 norm of the distribution differ where errors of pairs cancel
    return {
        "output": off(here.output, there.output),
        "rms": apart(lambda figures: np.linalg.norm(figures.output)),
        "J_T": apart(lambda figures: figures.sliding.mean()),
        "largest normal force": apart(lambda figures: figures.normal_force.max()),
        "normal forces": off(here.normal_force, there.normal_force),
        "deepest wear": apart(lambda figures: figures.wear.max()),
        "wear": off(here.wear, there.wear),
        "signorini": max(here.penetration, here.tension),
        "coulomb": here.cone_violation,
    }


@dataclass(frozen=True, eq=False)
class Setting:
    """One position of one knob, and the problem that it poses."""

    knob: str
    value: float
    problem: ContactProblem = field(repr=False)
    tolerance: float = 1e-8


def list_settings(problem: ContactProblem, orders: Sequence[int], fixed: int) -> list[Setting]:
    """The knobs of a contact solve, one turned at a time.

    Args:
        problem: The problem; its model, laws and loads are kept.
        orders: Highest harmonics to try.
        fixed: Highest harmonic where another knob is turned.
    """
    driven = max(problem.driven, default=1)
    orders, fixed = [n for n in orders if n >= driven], max(fixed, driven)
    usual = replace(problem, harmonics=fixed, samples=None)
    settings = [Setting("N", n, replace(usual, harmonics=n)) for n in orders]
    low = [n for n in orders if n <= HIGHEST_VARIANT]
    for n in orders:
        posed = replace(usual, harmonics=n)
        if not n or read_friction_weight(posed) is None:
            continue
        if n in low:
            matched = use_mobility(posed)
            settings.append(Setting("N, rho_T by mobility", n, matched))
            lean = replace(matched, samples=choose_samples(n, 8.0))
            settings.append(Setting("N, rho_T by mobility, 8 N samples", n, lean))
        closed = replace(posed, closure="spring")
        if "springs" in closed.system.closures:
            settings.append(Setting("N, springs", n, closed))
            settings.append(Setting(f"N, springs, tolerance {LOOSE:g}", n, closed, LOOSE))
    odd = lambda n: tuple(h for h in range(n + 1) if h % 2 or h in problem.loads or h == 0)  # noqa: E731
    settings += [Setting("N, odd harmonics only", n, replace(usual, harmonics=odd(n))) for n in low if n > 2]
    counts = dict.fromkeys([2 * fixed + 1, 3 * fixed, 4 * fixed, 8 * fixed, 16 * fixed, 32 * fixed, 64 * fixed])
    settings += [Setting("samples", n, replace(usual, samples=n)) for n in counts]
    normal, friction = read_weight(usual, "normal"), read_friction_weight(usual)
    for factor in (0.01, 0.1, 1.0, 10.0, 100.0):
        if normal is not None:
            settings.append(Setting("rho_N over default", factor, replace(usual, rho_normal=factor * normal)))
        if friction is not None:
            settings.append(Setting("rho_T over default", factor, replace(usual, rho_tangential=factor * friction)))
    settings += [Setting("tolerance", t, usual, t) for t in (1e-3, 1e-4, 1e-6, 1e-8, 1e-10)]
    return settings


def survey(
    settings: Iterable[Setting],
    reference: Figures,
    repeats: int,
    report: Callable[[dict], None] = lambda row: None,
) -> list[dict]:
    """Cold solves: errors, times and sizes of each setting.

    Args:
        settings: What to solve.
        reference: What to compare with.
        repeats: Solves of each setting, unless they take seconds; times are medians.
        report: Called with each row.

    Returns:
        A row a setting: knob, value, unknowns, Newton steps, whether it converged, processor seconds and the errors by
        name.
    """
    rows = []
    for setting in settings:
        spent: list[float] = []
        while len(spent) < repeats and sum(spent) < 2.0:
            posed = replace(setting.problem)  # nothing computed for an earlier solve is reused, but what a model keeps
            begin = time.process_time()
            solution = solve(posed, tolerance=setting.tolerance, raise_on_failure=False)
            spent.append(time.process_time() - begin)
        errors = compare_figures(measure_figures(solution), reference)
        row = {"knob": setting.knob, "value": setting.value, "unknowns": solution.unknowns}
        solved = solution.converged and solution.problem is posed  # not with the default weights in place of its own
        row |= {"steps": solution.iterations, "converged": solved, "seconds": median(spent)}
        rows.append(row | {"errors": errors})
        report(rows[-1])
    return rows


def find_front(rows: Sequence[Mapping], error: str) -> list[int]:
    """Which rows no other beats in both time and an error: the Pareto front, from fast to accurate."""
    order = sorted(
        (i for i, row in enumerate(rows) if row["converged"]),
        key=lambda i: (rows[i]["seconds"], rows[i]["errors"][error]),
    )
    front, best = [], np.inf
    for i in order:
        if rows[i]["errors"][error] < best:
            front.append(i)
            best = rows[i]["errors"][error]
    return front


def fit_slope(size: Sequence[float], error: Sequence[float]) -> float:
    """Exponent ``p`` of ``error ~ size^p`` by least squares in the logarithms; NaN below three points."""
    size, error = np.asarray(size, dtype=float), np.asarray(error, dtype=float)
    usable = (size > 0) & (error > 0)
    if usable.sum() < 3:
        return np.nan
    return float(np.polyfit(np.log(size[usable]), np.log(error[usable]), 1)[0])


def choose_cheapest(rows: Sequence[Mapping], error: str, level: float) -> Mapping | None:
    """The fastest row whose error is at most ``level`` and stays there with more of its knob; None: none is."""
    best = None
    for row in rows:
        if not row["converged"] or row["errors"][error] > level:
            continue
        more = [r for r in rows if r["knob"] == row["knob"] and r["unknowns"] > row["unknowns"]]
        if row["knob"].startswith("N") and any(r["errors"][error] > level for r in more):
            continue  # met by chance
        if best is None or row["seconds"] < best["seconds"]:
            best = row
    return best
