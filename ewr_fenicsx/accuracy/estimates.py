"""How far a periodic solution is from the one without truncation, estimated from the solution itself.

The error is that of the outputs' oscillation over a period: the norm of the difference over the norm, the largest over
the outputs; phase counts. It is estimated by single Newton steps on a neighbouring problem (``looking_ahead.py``):

- *harmonics*: half as many again; what they leave of the laws drives the step, and all harmonics answer. Where springs
  close the truncation, twice as many, with dashpots. Those further off count as well where the open joint resonates.
- *samples*: twice as many at the same harmonics.
- *weight*: another ``rho_T``, which would change nothing if nothing were truncated. It adds to what harmonics do.
- *modes*: a third fewer (``modes_left_out.py``), or what any mode beyond may do where those tell nothing; and where the
  frequencies of full stick are known, the inertia that these take.

The first two cost one step if they are changed at once, and a second step on the same problem sharpens the answer; in
large joints operator splitting gets there in less time.
What the weight does is looked at apart: it may cancel against the harmonics.

The outputs may know little of what happens in the joint: a further ``figure`` of a solution, such as its wear, may be
asked to be as accurate as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from reprlib import repr as shorten
from typing import NamedTuple

import numpy as np

from ewr_fenicsx.accuracy.looking_ahead import approach, look_ahead, take_step
from ewr_fenicsx.accuracy.modes_left_out import ModesBesideResponses, correct_inertia, keep_fewer
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import ComplexArray, RealArray, read_numbers
from ewr_fenicsx.laws.cone import FrictionLaw
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.problem.dashpots import read_friction_weight
from ewr_fenicsx.solution.indicators import measure_work
from ewr_fenicsx.solution.loading_history import find_missed_mean
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solver.newton import solve

WEIGHT_CHANGE = 2.0  # of rho_T, in the estimate of what the weight does
# The error falls like N^-RATE: what a next order is chosen by, and what lies beyond a look ahead. With dashpots, beyond
# the first set of harmonics, that is slower: with 1 / N for one mass, faster for most blocks and rows of masses.
RATE, RATE_WITH_DASHPOTS = 2.0, 1.5
FIRST_ORDER = 3  # highest harmonic up to which no springs are used: so few say little with them
ROUNDED = 1e-12  # share of the largest response, below which another one is its rounding
# Share of what contact and loads would move if none cancelled, below which what moves is what solves leave, and looks
# ahead, which do not end at a solution
AT_REST = 1e-7
USUAL = 0.05  # accuracy about which a rough estimate should be right
CLEAR = 4.0  # times above or below the accuracy, where one step's estimate needs no second look
# Unknowns of a solution, up to which a neighbouring problem is solved where single steps fail: that has twice as many,
# and at 1500 took ten times the solve itself
LARGEST_AHEAD = 1000
SURPRISE = 5.0  # times below how far the solution moved with its last harmonics, where it needs one after all
# Of the estimated error of the sliding: over that of the response, and by itself, from where on it is worth a word
FAR_OFF, WORTH_A_WORD = 2.0, 0.05
# What modes left out may do at most, from where on they are not thought to take part as those kept do; and the share of
# it that those kept do at least where they tell
NEAR, BLIND = 1 / 3, 1e-6
COARSE, UNKNOWN = 0.02, 1.0  # estimated error that a user should know a remedy for; one that tells no more than that
Figure = Callable[[PeriodicSolution], RealArray]


class Look(NamedTuple):
    """What a look ahead tells: estimated errors of the response (and a figure), and of the sliding."""

    error: float
    sliding: float


@dataclass(frozen=True)
class ErrorEstimate:
    """Estimated errors of a solution, relative, by cause; NaN where a cause was not looked at.

    Attributes:
        harmonics: By the harmonics left out, or by them and the samples together.
        samples: By the samples at which the laws are evaluated, looked at by themselves.
        weight: What another weight of the friction law would change; it is truncation seen from another side.
        modes: By the modes left out of the reduced model.
        sliding: Of ``J_T``, or of what presses as it slides or friction dissipates where that is more, by harmonics and
            samples: a figure of its own, in no total. It converges more slowly.
    """

    harmonics: float
    samples: float
    weight: float = np.nan
    modes: float = np.nan
    sliding: float = np.nan

    @property
    def total(self) -> float:
        """The whole: the causes added up."""
        return float(np.nansum([self.harmonics, self.weight, self.samples, self.modes]))

    @property
    def shares(self) -> str:
        """What each cause does that was looked at, for people."""
        first = "harmonics and samples" if np.isnan(self.samples) else "harmonics"
        causes = {first: self.harmonics, "samples": self.samples, "weight": self.weight, "modes": self.modes}
        return ", ".join(f"{name} {error:.1g}" for name, error in causes.items() if not np.isnan(error))

    @property
    def told_sliding(self) -> str:
        """What is to be said of the sliding, for people; "" where it is no further off than all else."""
        worse = self.sliding > max(FAR_OFF * self.total, WORTH_A_WORD)
        return f"sliding (J_T, dissipation) may be off by {self.sliding:.0%}" if worse else ""

    def tell(self, what: str, remedy: str) -> str:
        """How far off ``what`` is thought to be, and the remedy where that is much, for people."""
        size = f"estimated error of {what} {self.total:.1g}"
        if not self.total < UNKNOWN:
            return f"NOT accurate: {size}; {remedy}"
        slides = f"; {self.told_sliding}" if self.told_sliding else ""
        line = f"{size} ({self.shares}){slides}"
        return f"{line}; {remedy}" if self.total > COARSE or slides else line

    @property
    def truncation(self) -> float:
        """What more harmonics would take away: what they leave out, and what the weight does."""
        return float(self.harmonics + np.nan_to_num(self.weight))

    @property
    def dominating(self) -> str:
        """The knob that is to be raised first; more harmonics also take away what the weight does."""
        errors = {"harmonics": self.truncation, "samples": self.samples, "modes": self.modes}
        return max(errors, key=lambda name: -1.0 if np.isnan(errors[name]) else errors[name])


def compare_responses(here: ComplexArray, there: ComplexArray, rest: RealArray | float = 0.0) -> float:
    """Relative distance of two responses ``(n_h, p)`` at the same harmonics above 0: the worst of ``p`` columns.

    Columns of which both are rounding beside the largest one are not compared, nor those of which both are below
    ``rest``, scalar or ``(p,)``.
    """
    size, other = (np.linalg.norm(response, axis=0) for response in (there, here))
    distance = np.linalg.norm(here - there, axis=0)
    larger = np.maximum(size, other)
    moves = larger > np.maximum(ROUNDED * larger.max(initial=0.0), rest)
    return float((distance[moves] / np.maximum(size[moves], np.finfo(float).tiny)).max(initial=0.0))


def read_response(motion: PeriodicSolution, orders: Sequence[int]) -> ComplexArray:
    """Oscillation of the outputs, ``(n_h, p)`` at ``orders`` above 0; without outputs, of all contact rows as one.

    Where these stick they do not move: their forces, as what they would move each row by itself, count as well.

    Args:
        motion: A periodic solution, or a steady state of ``integrate``.
        orders: Harmonics; those that it lacks are zero.
    """
    problem, outputs = motion.problem, [motion.output(name) for name in motion.problem.model.outputs]
    if outputs:
        amplitudes = np.column_stack(outputs)
    else:
        forces, moved = motion.contact_amplitudes
        amplitudes = np.hstack([moved, problem.system.flexibility * forces])
    known, response = problem.basis.orders, np.zeros((len(orders), amplitudes.shape[1]), dtype=complex)
    for j, h in enumerate(orders):
        if h and h in known:
            response[j] = amplitudes[known.index(h)]
    return response if outputs else response.reshape(-1, 1)


def bound_response(solution: PeriodicSolution) -> RealArray:
    """``(p,)`` norms of what ``read_response`` reads, if no contact forces and loads cancelled."""
    compliance, above = solution.problem.system.compliance, np.array(solution.orders) > 0
    bounds = [compliance.bound_output(name, solution.forces)[above] for name in solution.problem.model.outputs]
    if not bounds:
        pushed = np.abs(solution.problem.system.flexibility * solution.forces)
        bounds = [np.hstack([compliance.bound_rows(solution.forces), pushed])[above].ravel()]
    return np.linalg.norm(bounds, axis=1)


def measure_distance(solution: PeriodicSolution, other: PeriodicSolution, figure: Figure | None = None) -> float:
    """Relative distance of the outputs' oscillations of two solutions with the same outputs; phase counts.

    Args:
        solution, other: Of problems with the same frequency, pairs and outputs.
        figure: What is to be compared as well, by the largest difference over the largest value.

    Raises:
        ModelError: ``figure`` gives no finite numbers, or not as many for both.
    """
    orders = sorted({*solution.orders, *other.orders})
    here, there = (read_response(s, orders) for s in (solution, other))
    distance = compare_responses(here, there, AT_REST * bound_response(other))
    if figure is None:
        return distance
    if not all(np.isfinite(s.forces).all() for s in (solution, other)):
        return np.inf
    here, there = (read_numbers("what figure returns", figure(s)) for s in (solution, other))
    if here.shape != there.shape or not (np.isfinite(here).all() and np.isfinite(there).all()):
        raise ModelError(
            f"figure returns {shorten(here)} and {shorten(there)}; give finite numbers, as many for every solution, "
            "whatever its harmonics"
        )
    largest = np.abs(there).max(initial=0.0)
    return max(distance, float(np.abs(here - there).max(initial=0.0) / largest) if largest else 0.0)


def step_towards(solution: PeriodicSolution, problem: ContactProblem, figure: Figure | None = None) -> float:
    """How far one Newton step on a neighbouring problem moves the outputs of a solution, relative.

    Args:
        solution: Converged.
        problem: The same joint with other harmonics, samples or weights.
        figure: As in ``measure_distance``.

    Returns:
        Infinity where the step cannot be solved for.
    """
    moved = take_step(solution, problem)
    return np.inf if moved is None else measure_distance(moved, solution, figure)


def estimate_harmonics(solution: PeriodicSolution, figure: Figure | None = None) -> float:
    """Error by the harmonics left out: one Newton step with half as many again, six at least."""
    return step_towards(solution, look_ahead(solution)[0], figure)


def estimate_together(
    solution: PeriodicSolution, accuracy: float, figure: Figure | None = None, moved: float = 0.0
) -> Look:
    """Error by harmonics and samples at once, as exactly as it takes to compare it with an accuracy.

    Where a first look tells of far more than the accuracy, or far less, that is all; but not where it tells of far
    less than the solution has ``moved``, by the same measure, from the one with fewer harmonics. Else a second look at
    the same problem follows (``approach``), mostly closer to the true error. They reach to a higher order N' only: they
    see the share ``1 - (N / N')^rate`` of the error, and its whole is returned.
    """
    problem, seen = look_further(solution)
    looks = (
        (ahead, measure_distance(ahead, solution, figure) / seen) for ahead in approach(solution, problem, accuracy)
    )
    lost = None, np.inf
    ahead, error = next(looks, lost)
    if not (error > CLEAR * accuracy or (CLEAR * error < accuracy and moved < SURPRISE * error)):
        ahead, error = next(looks, lost)
    return Look(error, np.inf if ahead is None else compare_sliding(ahead, solution) / seen)


def compare_sliding(ahead: PeriodicSolution, solution: PeriodicSolution) -> float:
    """Relative difference of the way that two solutions slide, over the longer one; 0 where both stick.

    That of what presses as it slides, over the larger one, where it is more: open pairs may make most of the way. Or
    that of the work of friction, ``friction_dissipation``, of which dashpots take some where the truncation is coarse.
    Where next to nothing presses as it slides, works are rounding. Ahead of a solution they may be negative.
    """
    slid, rubbed = [], []
    for force, speed in (each.press_and_slide(each.problem.basis.samples) for each in (ahead, solution)):
        slid.append(float(np.mean(speed)))
        rubbed.append(float(np.mean(force * speed)))
    rest = AT_REST * float(np.mean(solution.slip_reach))
    if not max(map(abs, slid)) > rest:
        return 0.0
    figures = [slid]
    if max(map(abs, rubbed)) > rest * float(np.mean(force)):
        figures += [rubbed, [_measure_friction(each) for each in (ahead, solution)]]
    return max(abs(there - here) / max(abs(there), abs(here)) for there, here in figures if there or here)


def _measure_friction(motion: PeriodicSolution) -> float:
    """Work of dry friction over a period, by the harmonics of its forces: what a solution dissipates by it [J]."""
    system = motion.problem.system
    laws = [law for law in system.laws if isinstance(law, FrictionLaw)]
    rows = [row for law in laws for row in system.row_of(law.direction, law.pairs)]
    return -measure_work(motion.forces[:, rows], motion.row_motion[:, rows], motion.orders)


def look_further(solution: PeriodicSolution) -> tuple[ContactProblem, float]:
    """A problem with more harmonics and samples than a solution's, and what share of its error that one sees."""
    raised, top = look_ahead(solution)
    seen = 1 - (solution.orders[-1] / max(1, top)) ** find_rate(solution.problem)
    return replace(raised, samples=2 * raised.basis.samples), seen


def find_rate(problem: ContactProblem) -> float:
    """Exponent by which the error falls with the highest harmonic."""
    rubs = any(law.direction == "tangential" and hasattr(law, "rho") for law in problem.system.laws)
    dashpots = rubs and problem.basis.orders[-1] > FIRST_ORDER and "springs" not in problem.system.closures
    return RATE_WITH_DASHPOTS if dashpots else RATE


def estimate_samples(solution: PeriodicSolution, figure: Figure | None = None) -> float:
    """Error by the sampling of the laws: one Newton step with twice the samples."""
    problem = solution.problem
    return step_towards(solution, replace(problem, samples=2 * problem.basis.samples), figure)


def estimate_weight(solution: PeriodicSolution, figure: Figure | None = None) -> float:
    """What another weight of the friction law would change: one Newton step with ``rho_T`` doubled."""
    problem = solution.problem
    weight = read_friction_weight(problem)
    if weight is None:
        return 0.0
    return step_towards(solution, replace(problem, rho_tangential=WEIGHT_CHANGE * weight), figure)


def estimate_errors(
    solution: PeriodicSolution, modes: Sequence[int] = (), figure: Figure | None = None
) -> ErrorEstimate:
    """All that a solution by itself says of its errors: Newton steps, the first with more harmonics.

    Args:
        solution: Converged.
        modes: As in ``estimate_modes``; none: they are not looked at.
        figure: As in ``measure_distance``.
    """
    causes = (estimate_harmonics, estimate_samples, estimate_weight)
    return ErrorEstimate(
        *(estimate(solution, figure) for estimate in causes),
        estimate_modes(solution, modes, figure),
    )


def estimate_at_once(
    solution: PeriodicSolution, modes: Sequence[int] = (), figure: Figure | None = None
) -> ErrorEstimate:
    """What a solution that nobody asked an accuracy of is off by, roughly: harmonics and samples together, and modes.

    The weight as well where mean friction is set to zero that would not be: it then shows whatever the harmonics. Where
    single Newton steps tell of a large error, it is mostly theirs: the neighbouring problem is then solved, where
    that does not take long.

    Args:
        solution, modes, figure: As in ``estimate_errors``.
    """
    weight = estimate_weight(solution, figure) if find_missed_mean(solution) else np.nan
    seen_ahead = estimate_together(solution, USUAL, figure)
    if seen_ahead.error > CLEAR * USUAL and solution.unknowns <= LARGEST_AHEAD:
        problem, seen = look_further(solution)
        ahead = solve(problem, solution, fallbacks=False, raise_on_failure=False)
        if ahead.converged:
            error, sliding = measure_distance(ahead, solution, figure), compare_sliding(ahead, solution)
            seen_ahead = Look(error / seen, sliding / seen)
    modal = estimate_modes(solution, modes, figure)
    return ErrorEstimate(seen_ahead.error, np.nan, weight, modal, seen_ahead.sliding)


def estimate_modes(solution: PeriodicSolution, modes: Sequence[int], figure: Figure | None = None) -> float:
    """Error by the modes left out: one Newton step with a third of those kept left out as well, the highest.

    Those may take no part in the motion, and those left out may: where nothing moves without them, and where loads are
    not far below the highest mode kept, it is what any mode beyond may do. Next to a resonance the least inertia counts
    that is left out: where the frequencies of full stick are known, another step goes to the model that has them.

    Args:
        solution: Converged.
        modes: Which coordinates of the model are modal, by rising frequency; none: NaN, for it is not looked at. As
            ``ModesBesideResponses`` where it has the static responses to its loads besides, or frequencies are known.
        figure: As in ``measure_distance``.
    """
    if not len(modes):
        return np.nan
    most = bound_beyond(solution.problem, modes)
    dropped = step_towards(solution, keep_fewer(solution.problem, modes), figure)
    error = dropped if most < NEAR and dropped > BLIND * most else max(dropped, most)
    if not (isinstance(modes, ModesBesideResponses) and modes.stuck):
        return error
    corrected = replace(solution.problem, model=correct_inertia(solution.problem.model, modes.stuck))
    return max(error, step_towards(solution, corrected, figure))


def bound_beyond(problem: ContactProblem, modes: Sequence[int]) -> float:
    """What modes above those kept may add at most to their static responses, over these: under the fastest load.

    Args:
        problem: On all modes kept.
        modes: As in ``estimate_modes``.
    """
    kept, model = list(modes), problem.model
    squares = np.diagonal(model.stiffness)[kept] / np.diagonal(model.mass)[kept]
    ratio = float((max(problem.driven, default=0) * problem.omega) ** 2 / squares.max())
    return min(UNKNOWN, ratio / (1.0 - ratio)) if ratio < 1.0 else UNKNOWN


def choose_harmonics(solution: PeriodicSolution, share: float) -> tuple[int, ...]:
    """The harmonics that matter: all but those with the least contact forces, together below a share of the whole.

    Loaded harmonics stay, and so do the mean and the first.

    Args:
        solution: Converged.
        share: Of the oscillating forces' norm, that may be left out.
    """
    orders = np.array(solution.orders)
    size = np.linalg.norm(solution.forces, axis=1)
    whole = np.linalg.norm(size[orders > 0])
    loaded = [h for h, f in solution.problem.excitation.items() if np.any(f)]
    fixed = np.isin(orders, [0, 1, *loaded])
    small_first = np.argsort(size)
    small_first = small_first[~fixed[small_first]]
    out = small_first[np.sqrt(np.cumsum(size[small_first] ** 2)) <= share * whole]
    return tuple(np.delete(orders, out).tolist())
