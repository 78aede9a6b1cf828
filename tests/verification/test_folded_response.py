"""A resonance curve that folds: a mass that meets a springy stop, against integration in time of the plain equation.

``x'' + c x' + x + k max(0, x - g) = F cos(2 pi f t)`` in one unknown, by a Runge-Kutta method from two sets of initial
conditions: no harmonic balance, no contact law, none of the package's time stepping.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from checked_solutions import find_turns, measure_residual
from scipy.integrate import solve_ivp
from small_models import stop_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, PeriodicSolution, ReducedModel, frequency_response, solve
from ewr_fenicsx.progress import count_progress
from ewr_fenicsx.response import following, frequency_sweep
from ewr_fenicsx.solver import continuation
from ewr_fenicsx.solver.continuation import BranchPoint, retraces

GAP, FORCE, DAMPING, STOP = 1.0, 0.08, 0.04, 1.0
LAWS = ContactLaws(tangential="frictionless", initial_gap=GAP)
BISTABLE = 0.1685  # Hz
FREQUENCIES = np.sort(np.append(np.linspace(0.12, 0.22, 21), BISTABLE))


@pytest.fixture(scope="module")
def curve():
    model = stop_oscillator(excitation=FORCE, damping=DAMPING, stop_stiffness=STOP)
    return frequency_response(model, LAWS, FREQUENCIES, harmonics=9, progress=False)


def integrate_in_time(frequency: float, start: tuple[float, float], periods: int = 150) -> np.ndarray:
    """One period of the steady state, 256 samples."""
    omega = 2 * np.pi * frequency

    def rate(t, state):
        x, v = state
        return v, FORCE * np.cos(omega * t) - DAMPING * v - x - STOP * max(0.0, x - GAP)

    times = (periods + np.arange(256) / 256) / frequency
    return solve_ivp(rate, (0, times[-1]), start, t_eval=times, rtol=1e-8, atol=1e-10, max_step=0.05 / frequency).y[0]


def test_the_curve_turns_back_and_forth_once(curve):
    turns = find_turns(curve.frequencies)
    assert len(turns) == 2
    assert curve.jumps == ()
    assert curve.missing == ()
    assert all(s.converged for s in curve.solutions)
    amplitude = np.abs(curve.output("tip")[:, 1])
    inside = slice(turns[0], turns[1] + 1)
    assert np.all(np.diff(curve.frequencies[inside]) < 0)
    assert np.all(np.diff(amplitude[turns[0] : turns[1] - 1]) < 0), "down the middle branch to the lower one"


def test_the_middle_branch_is_told_to_be_unstable(curve):
    """Of the two points at the folds' noses either may be on the unstable side."""
    turns = find_turns(curve.frequencies)
    assert curve.unstable[turns[0] + 1 : turns[1]].all()
    assert not curve.unstable[: turns[0]].any() and not curve.unstable[turns[1] + 1 :].any()
    np.testing.assert_array_equal(curve.table()["unstable"], curve.unstable)


def test_where_a_curve_turns_back_its_summaries_say_what_its_table_says(curve, monkeypatch):
    """Next to a fold a point was stable in the table, and called unstable where it was told of by itself."""
    np.testing.assert_array_equal([solution.unstable for solution in curve.solutions], curve.unstable)
    for name, seen in (("grows", True), ("alternates", False), ("multiplier", 0.0)):
        monkeypatch.setattr(PeriodicSolution, name, seen)
    assert replace(curve, solutions=[replace(solution) for solution in curve.solutions]).unstable.all()


def test_no_determinant_is_looked_at_where_no_curve_turns_back(monkeypatch):
    monkeypatch.delattr("ewr_fenicsx.solution.solution.find_side")
    straight = frequency_response(stop_oscillator(), LAWS, [0.1, 0.11, 0.12], harmonics=5, progress=False)
    assert not straight.unstable.any()


def test_a_trial_step_to_no_frequency_ends_no_sweep():
    """Two coupled masses, a stop that rubs and a load of three harmonics: from a corner, a trial went below zero."""
    stiffness = sum(
        k * np.outer(row, row)
        for k, row in (
            (1.0, np.array([1.0, 0.0, 0.0, 0.0])),
            (2.0, np.array([1.0, -1.0, 0.0, 0.0])),
            (0.5, np.array([0.0, 1.0, 0.0, 0.0])),
            (1.5, np.array([1.0, 0.0, -1.0, 0.0])),
            (1.0, np.array([0.0, 1.0, 0.0, -1.0])),
            (0.05, np.array([0.0, 0.0, 0.0, 1.0])),
            (0.2, np.array([0.0, 0.0, 1.0, 1.0])),
        )
    )
    mass = np.diag([1.0, 0.5, 0.0, 0.0])
    model = ReducedModel(
        mass=mass,
        damping=0.02 * mass + 0.01 * stiffness,
        stiffness=stiffness,
        normal=[[0.0, 0.0, -1.0, 0.0]],
        tangential=[[0.0, 0.0, 0.0, 1.0]],
        load={0: [0.05, 0, 0, 0], 1: [0.12, 0.05j, 0, 0], 3: [0, 0.08j, 0, 0]},
        outputs={"a": [1.0, 0.0, 0.0, 0.0]},
    )
    laws = ContactLaws(friction=0.5, initial_gap=0.25)
    curve = frequency_response(model, laws, np.linspace(0.13, 0.30, 35), harmonics=15, progress=False)
    assert np.isin(np.linspace(0.13, 0.30, 35), curve.frequencies).mean() > 0.9
    assert curve.frequencies.min() > 0.1


def test_a_trial_step_far_above_all_frequencies_is_held_back(monkeypatch):
    """Of bodies that rattle one went to 1e15 times the highest, and scipy warned of matrices a hundred times."""
    tried = []

    def leap_far(balance_at, *_, **__):
        tried.append(balance_at(1e20).system.compliance.omega)
        return iter(())

    monkeypatch.setattr(following, "trace_branch", leap_far)
    model = stop_oscillator(excitation=FORCE, damping=DAMPING, stop_stiffness=STOP)
    frequency_response(model, LAWS, FREQUENCIES, harmonics=5, progress=False)
    assert 0 < max(tried) < 100 * 2 * np.pi * FREQUENCIES.max()


def test_where_one_trace_loses_the_branch_a_narrower_one_is_tried(curve, monkeypatch):
    """At a corner a wide step may leap to another branch, from which no way leads on."""
    trace, widths = following.trace_branch, []

    def leap_where_wide(*arguments, stray, **settings):
        widths.append(stray)
        for n, point in enumerate(trace(*arguments, stray=stray, **settings)):
            if stray == max(following.STRAYS) and n == 5:
                return
            yield point

    monkeypatch.setattr(following, "trace_branch", leap_where_wide)
    model = stop_oscillator(excitation=FORCE, damping=DAMPING, stop_stiffness=STOP)
    frequencies = np.unique(np.round(np.append(np.linspace(0.12, 0.22, 21), BISTABLE), 12))
    again = frequency_response(model, LAWS, frequencies, harmonics=9, progress=False)
    assert len(widths) > 1 and widths[1] < widths[0]
    assert again.jumps == () and again.missing == ()
    assert len(find_turns(again.frequencies)) == 2
    for f in frequencies:
        (first,), (second,) = (np.flatnonzero(np.abs(c.frequencies - f) < 1e-9) for c in (again, curve))
        assert again.output("tip")[first, 1] == pytest.approx(curve.output("tip")[second, 1], rel=1e-6)


def test_every_point_of_the_curve_solves_its_problem(curve):
    for s in curve.solutions:
        assert measure_residual(s) < 1e-7


def test_points_round_a_fold_meet_the_tolerance_asked_for(curve):
    """What is traced by arc length as well as what is solved by itself."""
    model = curve.solutions[0].problem.model
    strict = frequency_response(model, LAWS, FREQUENCIES, harmonics=9, progress=False, tolerance=1e-11)
    traced = [s for s in strict.solutions if "arc length" in s.reason]
    assert len(traced) > 3
    assert all(s.converged and s.residual <= 1e-11 for s in strict.solutions)


def test_a_loose_tolerance_loses_no_branch_at_a_fold():
    """At 1e-3 steps led on beyond the nose, from where no trace came back: 11 points with a jump were left."""
    model = stop_oscillator(excitation=0.1, damping=0.04, stop_stiffness=6.0)
    laws, frequencies = replace(LAWS, initial_gap=1.75), np.linspace(0.13, 0.22, 11)
    curve = frequency_response(model, laws, frequencies, harmonics=3, tolerance=1e-3, progress=False)
    assert curve.jumps == ()
    assert np.any(curve.unstable) and curve.frequencies[find_turns(curve.frequencies)[-1]] < 0.163


def test_who_waits_sees_how_far_a_fold_has_been_traced(monkeypatch):
    """A branch that closes on itself takes hundreds of points, in which no block ends."""
    notes = []

    @contextmanager
    def record(title, total, shown):
        yield lambda done=None, note="": notes.append(note)

    monkeypatch.setattr(frequency_sweep, "count_progress", record)
    frequency_response(stop_oscillator(excitation=FORCE), LAWS, FREQUENCIES, harmonics=9, progress=False)
    told = [note for note in notes if note]
    assert told[0].startswith("fold at 0.1") and told[0].endswith(" Hz, 10 points")
    assert notes[notes.index(told[-1]) + 1] == "", "and when it is passed, no more"


@pytest.mark.parametrize("shown", [True, False])
def test_a_note_stands_beside_what_is_counted(capsys, shown):
    with count_progress("frequency response", 3, shown) as report:
        report(1)
        report(note="fold at 3.5 Hz, 10 points")
    printed = capsys.readouterr().err
    assert ("frequency response, fold at 3.5 Hz" in printed and "1/3" in printed) if shown else not printed


@pytest.mark.parametrize("distance", [0.5, 1.5, 2.5, 1000.0])
def test_a_target_that_no_step_reaches_is_left_after_a_few_tries(curve, distance, monkeypatch):
    """However close: half a step that is drawn to the target is the whole step again."""
    here, tries = curve.solutions[0], []

    def fail(self, frequency, *_):
        tries.append(frequency)
        assert len(tries) < 50
        return None, np.inf, np.inf

    monkeypatch.setattr(following.Follower, "_step", fail)
    monkeypatch.setattr(following.Follower, "_trace", lambda *_: following.Curve())
    away = distance * following.SMALLEST_STEP * here.problem.frequency
    follower = following.Follower(lambda f: here.problem, 0.1, 0.2)
    assert not follower.follow([here], [here.problem.frequency + away]).points
    assert not follower.descend(here, [here.problem.frequency - away])
    assert len(tries) >= 2


def test_the_lower_fold_is_where_the_stop_is_grazed(curve):
    """Below the gap the mass is linear; it grazes the stop where ``F / |1 - w^2 + i c w| = g``."""
    turn = find_turns(curve.frequencies)[1]
    w2 = np.roots([1.0, DAMPING**2 - 2.0, 1.0 - (FORCE / GAP) ** 2]).max()
    assert curve.frequencies[turn] == pytest.approx(np.sqrt(w2) / 2 / np.pi, rel=1e-4)


@pytest.mark.parametrize("start, branch", [((2.0, 0.0), "upper"), ((0.0, 0.0), "lower")])
def test_both_stable_branches_are_those_of_time_integration(curve, start, branch):
    """At a frequency with three solutions."""
    turns = find_turns(curve.frequencies)
    pieces = {"upper": slice(0, turns[0] + 1), "lower": slice(turns[1], None)}
    numbers = np.arange(len(curve.solutions))[pieces[branch]]
    on_branch = [curve.solutions[n] for n in numbers]
    frequencies = np.array([s.problem.frequency for s in on_branch])
    nearest = on_branch[int(np.argmin(np.abs(frequencies - BISTABLE)))]
    found = solve(ContactProblem(nearest.problem.model, LAWS, BISTABLE, harmonics=21), start=nearest)
    assert found.fallbacks == ()
    phase = 2 * np.pi * np.outer(np.arange(256) / 256, found.orders)
    motion = (np.exp(1j * phase) @ found.output("tip")).real
    steady = integrate_in_time(BISTABLE, start)
    np.testing.assert_allclose(motion, steady, atol=2e-3 * np.abs(steady).max())
    assert (np.abs(steady).max() > GAP) == (branch == "upper")


def test_a_sweep_that_starts_on_the_lower_branch_stays_on_it():
    """From above the folds nothing leads to the upper branch but the fold itself: no point is invented."""
    model = stop_oscillator(excitation=FORCE, damping=DAMPING, stop_stiffness=STOP)
    curve = frequency_response(model, LAWS, np.linspace(0.172, 0.22, 7), harmonics=9, progress=False)
    exact = FORCE / np.abs(1 - (2 * np.pi * curve.frequencies) ** 2 + 2j * np.pi * curve.frequencies * DAMPING)
    np.testing.assert_allclose(np.abs(curve.output("tip")[:, 1]), exact, rtol=1e-9)


def sweep_between_two_stops(harmonics: int):
    """``x'' + 0.03 x' + x + 2 (max(0, x - 0.5) - max(0, -x - 0.5)) = 0.2 cos``: both stops are grazed at once."""
    k = 2.0
    model = ReducedModel(
        mass=np.diag([1.0, 0.0, 0.0]),
        damping=np.diag([0.03, 0.0, 0.0]),
        stiffness=[[1.0 + 2 * k, -k, -k], [-k, k, 0.0], [-k, 0.0, k]],
        normal=[[0.0, -1.0, 0.0], [0.0, 0.0, 1.0]],
        load={1: [0.2, 0.0, 0.0]},
        outputs={"tip": [1.0, 0.0, 0.0]},
    )
    laws = ContactLaws(tangential="frictionless", initial_gap=0.5)
    frequencies = np.linspace(0.5, 2.0, 16) / (2 * np.pi)
    curve = frequency_response(model, laws, frequencies, harmonics=harmonics, progress=False)
    return curve, find_turns(curve.frequencies)


def test_a_leap_over_a_corner_does_not_lead_back():
    """The curve went back up the middle branch that it had come from, and ended in a jump."""
    curve, turns = sweep_between_two_stops(5)
    assert curve.jumps == () and curve.missing == ()
    assert turns.size == 2
    assert np.count_nonzero(curve.unstable) > 10, "the middle branch"
    omega = 2 * np.pi * curve.frequencies[-1]
    assert np.abs(curve.output("tip")[-1, 1]) == pytest.approx(0.2 / np.abs(1 - omega**2 + 0.03j * omega))


@pytest.mark.parametrize(("damping", "stop", "gap"), [(0.03, 0.5, 1.5), (0.05, 2.0, 1.0), (0.05, 2.0, 1.5)])
def test_a_nose_that_steps_through_frequency_leapt_over_is_gone_round_all_the_same(damping, stop, gap):
    """On the middle branch they rose back up to it, and the trace went down the branch that they had come from.

    In a nose that wriggles the branch turns more often. Below the gap the mass is linear.
    """
    model = stop_oscillator(excitation=0.1, damping=damping, stop_stiffness=stop)
    laws = ContactLaws(tangential="frictionless", initial_gap=gap)
    curve = frequency_response(model, laws, np.linspace(0.12, 0.26, 8), harmonics=3, progress=False)
    turns = find_turns(curve.frequencies)
    assert curve.jumps == () and curve.missing == ()
    assert turns.size == 4
    assert np.all(np.diff(curve.frequencies[turns[-2] : turns[-1] + 1]) < 0)
    after = curve.frequencies > curve.frequencies[turns[-1]] + 1e-3
    after[: turns[-1]] = False
    omega = 2 * np.pi * curve.frequencies[after]
    linear = 0.1 / np.abs(1 - omega**2 + damping * 1j * omega)
    np.testing.assert_allclose(np.abs(curve.output("tip")[after, 1]), linear, rtol=1e-6)


def meet_two_stops(mass: float, damping: float, near: float, far: float, side: float = 1.0) -> ReducedModel:
    """A mass on a spring of 1 N/m under 0.1 N, with a stop of stiffness ``near`` ahead and one of ``far`` behind it.

    With ``side = -1`` both are ahead.
    """
    return ReducedModel(
        mass=np.diag([mass, 0.0, 0.0]),
        damping=np.diag([damping, 0.0, 0.0]),
        stiffness=[[1.0 + near + far, -near, side * far], [-near, near, 0.0], [side * far, 0.0, far]],
        normal=[[0.0, -1.0, 0.0], [0.0, 0.0, -1.0]],
        load={1: [0.1, 0.0, 0.0]},
        outputs={"tip": [1.0, 0.0, 0.0]},
    )


def find_grazing(mass: float, damping: float, gap: float) -> float:
    """Above its resonance, where the mass just reaches a stop under a force of 0.1 [Hz]."""
    w2 = np.roots([mass**2, damping**2 - 2 * mass, 1.0 - (0.1 / gap) ** 2]).max()
    return np.sqrt(w2) / 2 / np.pi


@pytest.mark.parametrize(
    ("model", "gaps", "span", "points", "harmonics"),
    [
        ((1.6, 0.025, 1.8, 1.9), [2.9, 2.8], (0.08, 0.16), 9, 7),
        ((1.0, 0.038, 4.2, 3.9, -1.0), [2.0, 0.7], (0.1, 0.21), 8, 7),
        ((1.0, 0.03, 4.7, 1.2), [0.9, 2.7], (0.1, 0.27), 6, 3),
    ],
)
def test_no_step_along_the_middle_branch_leaps_over_the_corner_at_its_end(model, gaps, span, points, harmonics):
    """Of two unequal stops: a long step landed where the mass is free, and the middle branch's end was left out.

    Close to it forces vanish: to the step the corner looks straight, however far the branch turns back there.
    """
    laws = ContactLaws(tangential="frictionless", initial_gap=gaps)
    frequencies = np.linspace(*span, points)
    curve = frequency_response(meet_two_stops(*model), laws, frequencies, harmonics=harmonics, progress=False)
    assert curve.jumps == () and curve.missing == ()
    lowest = curve.frequencies[find_turns(curve.frequencies)[-1]]
    assert lowest == pytest.approx(find_grazing(*model[:2], min(gaps)), rel=5e-3)


def test_from_a_piece_beyond_a_nose_a_fold_is_gone_round_in_the_sense_of_the_curve():
    """The last two points lay on two pieces of a wriggle: along both the trace ran back down where it had come from."""
    laws = ContactLaws(tangential="frictionless", initial_gap=[1.2, 0.5])
    model = meet_two_stops(1.0, 0.037, 2.2, 2.6, -1.0)
    curve = frequency_response(model, laws, np.linspace(0.1, 0.26, 11), harmonics=3, progress=False)
    assert curve.jumps == () and curve.missing == ()
    lowest = curve.frequencies[find_turns(curve.frequencies)[-1]]
    assert lowest == pytest.approx(find_grazing(1.0, 0.037, 0.5), rel=5e-3)


def test_adaptive_frequencies_next_to_a_nose_are_in_the_order_of_the_branch():
    """A step leapt onto the middle branch, and the next one back: the point between stood before the nose."""
    laws = ContactLaws(tangential="frictionless", initial_gap=[1.9, 1.6])
    model = meet_two_stops(1.0, 0.034, 3.5, 2.0, -1.0)
    curve = frequency_response(model, laws, np.linspace(0.1, 0.22, 7), harmonics=6, refine=0.3, progress=False)
    turns = find_turns(curve.frequencies)
    side = np.array([solution.side for solution in curve.solutions])
    assert curve.jumps == () and turns.size == 2
    assert np.all(side[: turns[0]] > 0) and np.all(side[turns[1] + 1 :] > 0)


def test_a_target_that_a_trace_passes_is_reached_from_nearer_by(curve, monkeypatch):
    """From two points far apart Newton's method may fail, and the whole branch was given up for that."""
    solve_once = following.solve_from

    def fail_from_afar(problem, latest, *others):
        found = solve_once(problem, latest, *others)
        return replace(found, converged=latest.problem.frequency < 1.01 * problem.frequency)

    monkeypatch.setattr(following, "solve_from", fail_from_afar)
    model = stop_oscillator(excitation=FORCE, damping=DAMPING, stop_stiffness=STOP)
    again = frequency_response(model, LAWS, FREQUENCIES, harmonics=9, progress=False)
    assert again.jumps == ()
    assert np.abs(again.output("tip")[-1, 1]) == pytest.approx(np.abs(curve.output("tip")[-1, 1]), rel=1e-6)


def test_corners_are_not_leapt_over_from_afar():
    """The curve left the middle branch 5 % above its end; below the gap the mass is linear."""
    curve, turns = sweep_between_two_stops(9)
    w2 = np.roots([1.0, 0.03**2 - 2.0, 1.0 - (0.2 / 0.5) ** 2]).max()
    assert curve.frequencies[turns[1]] == pytest.approx(np.sqrt(w2) / 2 / np.pi, rel=5e-3)


def test_a_corner_is_turned_without_creeping_into_it(monkeypatch):
    """Steps were halved twenty times before it was looked where the branch leads."""
    correct, steps = continuation._correct, []

    def measure(balance_at, here, ahead, *rest):
        steps.append(np.linalg.norm(ahead))
        return correct(balance_at, here, ahead, *rest)

    monkeypatch.setattr(continuation, "_correct", measure)
    _, turns = sweep_between_two_stops(5)
    assert turns.size == 2
    assert min(steps) > 1e-4


def go_round(angles, pitch: float = 0.0) -> list[BranchPoint]:
    """Points of an ellipse in the parameter and one unknown, ``pitch`` a turn apart in another."""
    return [BranchPoint(0.02 * np.cos(a), np.array([np.sin(a), pitch * a / (2 * np.pi)]), 1) for a in angles]


def test_a_closed_curve_is_told_on_its_second_lap():
    rng = np.random.default_rng(0)
    angles = np.cumsum(rng.uniform(0.1, 0.3, 60))
    laps = angles / (2 * np.pi)
    told = [retraces(go_round(angles[:n]), 0.05) for n in range(1, 61)]
    assert not any(told[: np.count_nonzero(laps < 1)])
    assert any(told[: np.count_nonzero(laps < 1.5)])


def test_a_branch_that_comes_close_to_itself_or_turns_back_on_itself_is_not_closed():
    angles = np.arange(0.0, 20.0, 0.2)
    there_and_back = [*go_round(angles[:12]), *go_round(angles[11::-1] + 0.05)]
    for points in (go_round(angles, pitch=0.1), there_and_back):
        assert not any(retraces(points[:n], 0.05) for n in range(1, len(points) + 1))


def test_a_sweep_does_not_go_round_in_circles(monkeypatch):
    """From an isolated curve no fold leads on: one lap of it, then the sweep starts again and says so."""
    laps = []

    def go_on_for_ever(balance_at, start, span, **settings):
        for n in range(1, following.TRACED_POINTS + 2):
            laps.append(n / 25)
            a, aside = 2 * np.pi * n / 25, np.zeros(start.unknowns.size)
            aside[0] = 0.1 * np.sin(a)
            yield BranchPoint(start.parameter - 0.01 * span * (1 - np.cos(a)), start.unknowns + aside, 1)

    monkeypatch.setattr(following, "trace_branch", go_on_for_ever)
    model = stop_oscillator(excitation=FORCE, damping=DAMPING, stop_stiffness=STOP)
    curve = frequency_response(model, LAWS, np.linspace(0.14, 0.22, 9), harmonics=5, progress=False)
    assert "closed curve" in curve.jumps[0].why
    assert len(curve.breaks) == len(curve.jumps), "a picture's line ends there"
    assert max(laps) < 2
    assert curve.missing == () and len(curve.solutions) == 9
