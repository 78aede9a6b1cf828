"""Floquet multipliers: whether small deviations from a periodic solution grow from period to period, turning or not.

A pair of complex multipliers beyond the unit circle changes no sign of a determinant (``stability.py``): motions leave
in a spiral, mostly for one that never repeats.

Deviations are stepped through the period from every unit state, for a guess (``deviations.py``): that displaces the
instants at which pairs change status by up to half a sample, and by itself would call some stable solutions unstable,
and some unstable ones stable. What counts are the exponents nearest to a guess on the solution's harmonics
(``hill.py``), where deviations also grow along the motion in time that begins on the solution: truncated, many pairs
that lift off may do so where the laws would not have it.

Source: Seydel (2010), Practical Bifurcation and Stability Analysis, doi:10.1007/978-1-4419-1740-9.
"""

from __future__ import annotations

import numpy as np

from ewr_fenicsx.balance.periodic_motion import PeriodicMotion
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.in_time.deviations import (
    PERIODS,
    Course,
    Monodromy,
    Slopes,
    differentiate_along,
    differentiate_laws,
    is_followed,
    step_deviations,
    watch_course,
)
from ewr_fenicsx.in_time.followed_modes import Followed, follow_modes, follow_waves
from ewr_fenicsx.in_time.hill import FOLLOWS, Hill, measure_edges
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.problem.contact_system import ContactSystem

MOST_UNKNOWNS = 1500  # of Hill's matrix: half a second
# Harmonics of the deviations at least, also where the solution has fewer: at the edge of fewer, Hill's matrix has
# exponents that are none. Solutions with more are not looked at with less.
FEWEST = 5
SAMPLES = 4 * FEWEST + 2  # a period, at least, of the laws' derivatives
STEPS, TRUSTED = (256, 128), 1e3  # a period; multiplier above which fewer are taken: it grows with their number
GROWTH = 1.02  # a period, from which on it counts: less is within the errors of truncation, also of many harmonics
BORNE_OUT = 1.005  # a period, from which on it is; where a body has slid to is neutral
# A motion in time that begins on a solution settles beside it where all of this holds after so many periods:
SETTLING = 80
FALLEN = 0.3  # its last change from period to period is below this share of the largest of the first five,
ABOVE_LEAST, NOTHING = 2.0, 1e-2  # below so many times the least change, or that share of the first ones,
STEADY = 1e-3  # and below this share of its oscillation;
RISEN = 1.05  # no change was above so many times the largest of the first five;
NEAR, AT_ONE = 0.25, 3e-3  # it went by less than this share of its oscillation, and by more than stepping may do
# Newton steps from there to a solution of as many harmonics, what they leave of the residual, and how far another
# solution's forces are at least
NEWTON_STEPS, SOLVED, ELSEWHERE = 30, 1e-6, 1e-3
# A guess may be too small: where Hill's matrix has few unknowns, the largest is looked at from this multiplier on
DOUBTFUL, LITTLE = 0.85, 400
EDGE = 0.5  # share of a deviation at the outermost harmonics, from which on it is cut off there; evenly spread: 0.36
GUESSES = 3  # at most, by each way of stepping
TURN = 2  # samples along the motion in time, for which a mass that turns may stick
NEUTRAL = 0.01  # distance from one, up to which a guess may be of what is neutral: where a body has slid to
SURE = 0.01  # imaginary part of a real determinant over its real one, from which on rounding decides its sign
TINY = np.finfo(float).tiny
REAL = 1e-3  # imaginary part of a multiplier over its modulus, up to which it counts as real
AT_ONCE, FASTEST = 1e-6, 100.0  # angular frequency over an exponent that counts as infinite; and none is told faster
SLOW = 1e-4  # exponent over the angular frequency that stands for none: at none, what sticks throughout is neutral


def find_growth(motion: PeriodicMotion) -> complex:
    """The largest Floquet multiplier beyond the unit circle.

    Args:
        motion: A solution, with a closure that does not remember.

    Returns:
        The one of a pair with positive imaginary part; 0 where none is seen, where too many rows change status to look,
        where a law remembers, where redundant pairs share their forces in any way, at rest: there is no period; and of
        a sector of a ring, whose neighbours may deviate in any way.
    """
    system = motion.problem.system
    top, rows = system.basis.orders[-1], system.rows.shape[0]
    if not top or system.model.cyclic:
        return 0.0
    if not rows:
        return find_linear_growth(system)
    slopes = differentiate_laws(motion, max(system.basis.samples, SAMPLES))
    if slopes is not None and not slopes.changing.size:
        slopes = slopes.treat_all_as_changing()
    if slopes is None or count_harmonics(system, slopes) < min(top, FEWEST):
        return 0.0
    try:
        guesses = guess_exponents(motion, DOUBTFUL if is_small(system, slopes) else GROWTH)
        found = max((refine(system, slopes, guess) for guess in guesses), key=abs, default=0.0)
        return found if found and is_borne_out(motion) else 0.0
    except np.linalg.LinAlgError:
        return 0.0


def list_unfollowed(motion: PeriodicMotion) -> dict[str, list[str]]:
    """For want of what the largest multiplier is not looked for: law's name -> variables that it sees, or "its past".

    Empty where no law sees any, and where no row changes status over the period, as at rest.
    """
    balance, unknowns = motion.pose()
    derivatives = balance.linearise(unknowns).derivatives
    if not any(np.any(d.changes) for d in derivatives):
        return {}
    owned = zip(balance.system.laws, balance.law_rows, strict=True)
    owners = {row: type(law).__name__ for law, rows in owned for row in rows}
    unfollowed: dict[str, set[str]] = {}
    for d in derivatives:
        if not is_followed(d):
            unfollowed.setdefault(owners[d.rows[0]], set()).add("its past" if d.remembers else d.variable)
    return {name: sorted(seen) for name, seen in unfollowed.items()}


def find_linear_growth(system: ContactSystem) -> complex:
    """``find_growth`` of a joint without unknown forces, by the exponents of its free vibrations."""
    omega = system.compliance.omega
    fastest = find_fastest(follow_modes(system, FOLLOWS * system.basis.orders[-1] * omega), omega)
    found = np.exp(2 * np.pi * complex(fastest.real, abs(fastest.imag)))
    return complex(found.real, abs(found.imag)) if abs(found) > GROWTH else 0.0


def find_fastest(modes: Followed, omega: float) -> complex:
    """Exponent over the angular frequency of the free vibration that grows most, or falls least; none above a bound."""
    mass, damping, one, none = omega**2 * modes.mass, omega * modes.damping, np.eye(len(modes.mass)), 0 * modes.mass
    rates, states = np.block([[none, one], [-modes.stiffness, -damping]]), np.block([[one, none], [none, mass]])
    inverses = np.linalg.eigvals(np.linalg.solve(rates - states, states)).astype(complex)
    exponents = 1 + 1 / inverses[np.abs(inverses) > AT_ONCE]  # over omega; without mass some are infinite
    fastest = max(exponents, key=lambda z: z.real, default=0j)
    return complex(min(fastest.real, FASTEST), fastest.imag)


def is_borne_out(motion: PeriodicMotion) -> bool:
    """Whether deviations grow along the motion in time that begins on a solution; if none is stepped, its series."""
    try:
        slopes, periods = differentiate_along(motion), PERIODS
    except (ModelError, ImportError):
        slopes, periods = differentiate_laws(motion, 2 * STEPS[0]), 1
    if slopes is None:
        return True
    sliding = slopes.slide_through_turns(TURN)
    return measure_growth(step_deviations(motion.problem.system, sliding, periods).matrix) > BORNE_OUT**periods


def settles(motion: PeriodicMotion) -> bool:
    """Whether the motion in time that begins on a solution comes to repeat itself, and is the one that it stands for.

    Nothing then leaves it, whatever truncated series say of how pairs lift off or slip. It begins as far from the
    motion without truncation as the solution is: what grows by two percent a period has grown fivefold in the end.
    False where it cannot be stepped, and where what it comes to has another solution of as many harmonics: a branch
    near by.
    """
    try:
        course = watch_course(motion, SETTLING)
    except (ModelError, ImportError):
        return False
    if course is None:
        return False
    changes, first, last = course.changes, course.changes[:5].max(), course.changes[-1]
    fallen = last < FALLEN * first and last < max(ABOVE_LEAST * changes.min(), NOTHING * first)
    beside = fallen and last < STEADY and changes.max() < RISEN * first and AT_ONE < course.distance < NEAR
    return bool(beside) and not leads_elsewhere(motion, course)


def leads_elsewhere(motion: PeriodicMotion, course: Course) -> bool:
    """Whether Newton's method finds another solution than this one from where a motion in time has come to."""
    balance, here = motion.pose()
    begin = balance.pack(course.forces, motion.rigid)
    found, _ = balance.take_whole_steps(begin, NEWTON_STEPS, balance.within(SOLVED), course.motion)
    # where none is found, nothing is known
    return found is not None and bool(np.linalg.norm(found - here) > ELSEWHERE * np.linalg.norm(here))


def measure_growth(whole: RealArray) -> float:
    """Modulus of the largest multiplier of a monodromy matrix; infinite where stepping overflowed."""
    return float(np.abs(np.linalg.eigvals(whole)).max(initial=0.0)) if np.all(np.isfinite(whole)) else np.inf


def guess_exponents(motion: PeriodicMotion, least: float) -> ComplexArray:
    """Exponents [1/s] of the multipliers that stepping sees beyond the unit circle, few, one of each pair.

    A mass that rubs sticks for some samples where it turns, and deviations of its velocity would be lost there, while
    in truth they jump by a factor near one. So they are stepped a second time, as if it slid on through sticking that
    is no longer than a period of the highest harmonic.

    Args:
        motion: As in ``find_growth``.
        least: Multiplier from which on the largest is given where none is beyond the circle.
    """
    system = motion.problem.system
    for steps in STEPS:
        slopes = differentiate_laws(motion, 2 * steps)
        stepped = step_deviations(system, slopes)
        if measure_growth(stepped.matrix) < TRUSTED:
            break
    sliding = slopes.slide_through_turns(1 + slopes.samples // system.basis.orders[-1])
    found = [stepped] if sliding is slopes else [stepped, step_deviations(system, sliding)]
    return np.concatenate([read_exponents(each, system.compliance.omega, least) for each in found])


def read_exponents(stepped: Monodromy, omega: float, least: float) -> ComplexArray:
    """Those of ``guess_exponents`` that the matrix of a period has.

    An exponent plus any harmonic's frequency is one as well: of these the one at which the deviation vibrates, whose
    harmonics are then about the middle of Hill's.
    """
    found, states = np.linalg.eig(stepped.matrix)
    modes = stepped.modes
    pick = np.flatnonzero((np.abs(found) > least) & (found.imag >= 0) & (np.abs(found - 1.0) > NEUTRAL))
    pick = pick[np.argsort(-np.abs(found[pick]))]
    pick = pick[: np.clip(np.count_nonzero(np.abs(found[pick]) > GROWTH), 1, GUESSES)]
    motion, velocity = states[:modes, pick], states[modes : 2 * modes, pick]
    exponents = np.log(found[pick].astype(complex)) * omega / (2 * np.pi)
    rate = np.sum(motion.conj() * velocity, axis=0) / np.maximum(np.sum(np.abs(motion) ** 2, axis=0), TINY)
    return exponents + 1j * omega * np.round((rate.imag - exponents.imag) / omega)


def refine(system: ContactSystem, slopes: Slopes, guess: complex) -> complex:
    """The largest of the multipliers with exponents near a guess that count; 0 where none does."""
    exponents, motions = Hill(system, slopes, guess, count_harmonics(system, slopes)).find_nearest()
    exponents = exponents[measure_edges(motions) < EDGE]
    found = max(np.exp(2 * np.pi * exponents / system.compliance.omega), key=abs, default=0.0)
    return complex(found.real, abs(found.imag)) if abs(found) > GROWTH else 0.0


def is_small(system: ContactSystem, slopes: Slopes) -> bool:
    """Whether Hill's matrix costs so little that doubtful guesses are looked at as well."""
    return (2 * count_harmonics(system, slopes) + 1) * slopes.changing.size <= LITTLE


def count_harmonics(system: ContactSystem, slopes: Slopes) -> int:
    """Highest harmonic of the deviations: the solution's or some more, as far as Hill's matrix does not grow large."""
    return min(max(system.basis.orders[-1], FEWEST), (MOST_UNKNOWNS // slopes.changing.size - 1) // 2)


def grows(motion: PeriodicMotion) -> bool | None:
    """Whether an odd number of real Floquet multipliers are above one: Hill's determinant is negative there.

    The Jacobian of the balance tells as much where every force follows from the motion. Mean friction does not: what
    sets it (``static_friction``) turns the sign where friction is strong enough to wedge, without any motion leaving.

    Of a sector of a ring the deviations are those in which all sectors move alike, each harmonic in its wave.

    Returns:
        None where a law remembers, where rounding decides, and of a ring whose stiffness is not positive.
    """
    system = motion.problem.system
    slopes = differentiate_laws(motion, system.basis.samples)
    if slopes is None:
        return None
    top, omega, modes = system.basis.orders[-1], system.compliance.omega, None
    if system.model.cyclic:
        waves, at = np.unique([system.model.wave_of(h) for h in range(-top, top + 1)], return_inverse=True)
        try:
            modes = follow_waves(system, FOLLOWS * top * omega, waves.tolist()).pick(at)
        except np.linalg.LinAlgError:
            return None
    hill = Hill(system, slopes.treat_all_as_changing(), SLOW * omega, top, modes)
    sign = np.linalg.slogdet(hill.matrix)[0]  # real, for the exponent is
    return bool(sign.real < 0) if abs(sign.imag) < SURE * abs(sign.real) else None


def tell_where_to(problem: ContactProblem, alternates: bool, multiplier: complex) -> str:
    """Where motions most often go that leave a solution, and how to see it; words to follow on "leave it"."""
    turns = abs(multiplier.imag) > REAL * abs(multiplier)
    kind = "repeats every second period" if alternates else "never repeats" if turns else ""
    often = f", most often for one that {kind}" if kind else ""
    if problem.own_kinds:
        return often
    stepped = "(...) on unroll_ring(model)" if problem.model.cyclic else "(problem, solution, tolerance=0)"
    return f"{often}; integrate{stepped} shows where to"
