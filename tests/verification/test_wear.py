"""Wear against closed forms: a rigid punch on a Winkler foundation, whose pressure is known while it wears.

Under a swing of amplitude X a pair slides ``4 X`` a cycle. With pressure ``p_k = k (d - w_k)`` and the mean pressure
given by the load, Archard's law makes differences of pressure decay by the factor ``1 - 4 k_w k X`` a cycle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from checked_solutions import slide_behind_dashpots
from counted_calls import count_calls
from small_models import dovetail, winkler_punch
from wear_pairs import measure_volumes
from worn_punch import AREA, LOAD, PAIRS, SHARP, STIFFNESS, SWING, punch

from ewr_fenicsx import (
    ContactLaws,
    ContactProblem,
    ReducedModel,
    Tolerance,
    evolve_wear,
    solve,
    solve_to_accuracy,
)
from ewr_fenicsx.accuracy.estimates import estimate_errors
from ewr_fenicsx.errors import NotConverged, UnheldBody
from ewr_fenicsx.output.wear_fields import tabulate_wear_fields
from ewr_fenicsx.response.following import solve_from
from ewr_fenicsx.runs.findings import list_facts_of_wear, tell_wear
from ewr_fenicsx.solution.contact_state import STICK, classify_contact
from ewr_fenicsx.wear import cycle_jumps
from ewr_fenicsx.wear.archard import find_explicit_limit, find_wear_stiffness, measure_wear_rate

MEAN_PRESSURE = LOAD / (PAIRS * AREA)
COEFFICIENT = 1e-11
DECAY = 4 * COEFFICIENT * STIFFNESS * SWING  # 2e-4 a cycle
CROWN = 1e-7 * np.array([4.0, 1.0, 0.0, 1.0, 4.0])  # initial gap of a rounded punch [m]


def pressures(history) -> np.ndarray:
    """``(steps, K)`` mean pressure of every pair."""
    forces = np.array([s.history("normal_force", 64).mean(axis=0) for s in history.solutions])
    return forces / history.problem.model.pair_area


def exact_depth(cycles):
    """Worn under uniform pressure [m]."""
    return 4 * COEFFICIENT * MEAN_PRESSURE * SWING * cycles


def differences_left(history) -> np.ndarray:
    """``(steps,)`` how much of its first differences the pressure still has."""
    differences = pressures(history) - MEAN_PRESSURE
    return differences @ differences[0] / (differences[0] @ differences[0])


def test_uniform_pressure_wears_evenly():
    history = evolve_wear(punch(), 50, COEFFICIENT)
    exact = exact_depth(history.cycles)
    np.testing.assert_allclose(history.depth, np.repeat(exact[:, None], PAIRS, axis=1), rtol=SHARP)
    np.testing.assert_allclose(history.total_volume, exact * AREA * PAIRS, rtol=SHARP)
    np.testing.assert_array_equal(history.cycles, np.arange(51))


def test_wear_follows_pressure_and_not_nodal_force():
    """Half the area a pair at twice the pairs: forces halve, depths stay."""
    fine = winkler_punch(load=LOAD, swing=SWING, stiffness=STIFFNESS, pairs=2 * PAIRS, area=AREA / 2)
    laws = ContactLaws(tangential="frictionless")
    depth = evolve_wear(ContactProblem(fine, laws, 100.0, harmonics=1), 20, COEFFICIENT).depth[-1]
    np.testing.assert_allclose(depth, evolve_wear(punch(), 20, COEFFICIENT).depth[-1, 0], rtol=1e-10)


def test_a_crown_wears_flat_at_the_rate_of_winkler():
    history = evolve_wear(punch(CROWN), 400, COEFFICIENT, keep_every=100)
    p = pressures(history)
    np.testing.assert_allclose(p[0] - MEAN_PRESSURE, STIFFNESS * (CROWN.mean() - CROWN), rtol=1e-9)
    left = (1 - DECAY) ** history.cycles[:, None] * (p[0] - MEAN_PRESSURE)
    np.testing.assert_allclose(p - MEAN_PRESSURE, left, atol=SHARP * np.abs(left).max())
    np.testing.assert_allclose(differences_left(history), (1 - DECAY) ** history.cycles, atol=SHARP)
    np.testing.assert_allclose(history.gap - history.depth, np.broadcast_to(CROWN, history.gap.shape), atol=1e-20)


def test_a_joint_worn_from_the_start_counts_that_wear_once():
    """Worn flat and deep before: where the mean load presses all pairs in, the rate is that of the unworn joint."""
    worn = 2e-6 + CROWN.max() - CROWN
    history = evolve_wear(replace(punch(CROWN), wear=worn), 20, COEFFICIENT, keep_every=10)
    rate = 4 * COEFFICIENT * MEAN_PRESSURE * SWING
    expected = worn + rate * history.cycles[:, None]
    np.testing.assert_allclose(history.depth - worn, expected - worn, atol=SHARP * 20 * rate)
    np.testing.assert_allclose(history.gap, CROWN + expected, atol=SHARP * 20 * rate)
    np.testing.assert_array_equal(tabulate_wear_fields(history)["worn_gap"], history.gap)


@pytest.mark.parametrize("damped", [True, False])
def test_jumps_decay_exponentially(damped):
    jump = Tolerance(share=1e-5, damped=damped)
    history = evolve_wear(punch(CROWN), 20_000, COEFFICIENT, jump)
    p = pressures(history)
    left = np.exp(-DECAY * history.cycles[:, None]) * (p[0] - MEAN_PRESSURE)
    assert history.solves < 600, "far fewer than cycles"
    np.testing.assert_allclose(p - MEAN_PRESSURE, left, atol=5e-4 * np.abs(left).max())


def test_explicit_limit_is_that_of_winkler():
    solution = solve(punch(CROWN))
    coefficient = np.full(PAIRS, COEFFICIENT)
    decay = find_wear_stiffness(solution, coefficient)
    assert find_explicit_limit(decay) == pytest.approx(2 / DECAY, rel=SHARP)
    assert find_explicit_limit(0 * decay) == np.inf


def jump_by_euler(share: float) -> np.ndarray:
    """``(6, K)`` wear rates less their mean over explicit jumps of a ``share`` of the limit [m/cycle]."""
    problem, coefficient, depth, differences = punch(CROWN), np.full(PAIRS, COEFFICIENT), np.zeros(PAIRS), []
    for _ in range(6):
        rate = measure_wear_rate(solve(replace(problem, wear=depth)), coefficient)
        differences.append(rate - rate.mean())
        depth = depth + share * 2 / DECAY * rate
    return np.array(differences)


@pytest.mark.parametrize("share, grows", [(0.9, False), (1.1, True)])
def test_either_side_of_the_explicit_limit(share, grows):
    """Euler jumps of one length: worn surfaces settle below the limit and oscillate ever more above it."""
    differences, factor = jump_by_euler(share), 1 - 2 * share
    assert (abs(factor) > 1) == grows and factor < 0
    np.testing.assert_allclose(differences[1:] / differences[:-1], factor, rtol=1e-3)


def test_explicit_jumps_stay_below_the_limit_however_loose_the_tolerance():
    """Asked for jumps twice as long as is stable, the loop shortens them, and the crown wears flat."""
    limit = 2 / DECAY
    loose = Tolerance(depth=1.0, first=int(2 * limit), damped=False)
    history = evolve_wear(punch(CROWN), int(40 * limit), COEFFICIENT, loose)
    assert np.diff(history.cycles).max() <= 0.9 * limit * (1 + SHARP)
    spread = np.ptp(pressures(history), axis=1)
    assert spread[-1] < 1e-3 * spread[0]
    assert np.all(spread[1:] <= spread[:-1] * (1 + 1e-9))


def test_damped_jumps_are_stable_far_beyond_the_limit():
    limit = 2 / DECAY
    loose = Tolerance(depth=1.0, first=int(5 * limit), damped=True)
    history = evolve_wear(punch(CROWN), int(40 * limit), COEFFICIENT, loose)
    assert np.diff(history.cycles).max() > 5 * limit - 1
    spread = np.ptp(pressures(history), axis=1)
    assert spread[-1] < 0.3 * spread[0]
    assert np.all(spread[1:] <= spread[:-1] * (1 + 1e-9))


@pytest.mark.parametrize(("excitation", "frequency"), [(100.0, 600.0), (300.0, 900.0)])
def test_no_jump_heals_however_loose_the_tolerance(excitation, frequency):
    """Jumps of second order, or those tried, would take more from some pairs than these have worn."""
    problem = ContactProblem(dovetail(excitation=excitation), ContactLaws(friction=0.2), frequency, 5)
    history = evolve_wear(problem, 2000, 1e-7, Tolerance(share=0.5))
    assert history.stopped is None and len(history.steps) < 50, "or it did not jump"
    assert np.diff(history.depth, axis=0, prepend=0.0).min() >= 0


def test_a_cycle_that_wears_more_than_contact_can_follow_ends_the_run():
    history = evolve_wear(punch(CROWN), 10, 1.01 * 2 / (4 * STIFFNESS * SWING))
    assert history.cycles[-1] == 0
    assert "lower the wear coefficient (in 1/Pa, mostly below 1e-9)" in history.stopped


def test_damped_jumps_cross_what_single_cycles_cannot():
    """Where a cycle wears more than contact can follow, as on a fine mesh, damped jumps still wear the crown flat."""
    coefficient = 2 / (0.8 * 4 * STIFFNESS * SWING)  # the limit is 0.8 cycles
    history = evolve_wear(punch(CROWN), 200, coefficient, Tolerance(share=1e-3, damped=True))
    assert history.stopped is None
    exact = 4 * coefficient * MEAN_PRESSURE * SWING * 200
    assert history.depth[-1].mean() == pytest.approx(exact, rel=1e-3)
    spread = np.ptp(pressures(history), axis=1)
    assert spread[-1] < 1e-3 * spread[0]


@pytest.mark.parametrize("rate", [2.2, 3.0, 6.0])
def test_a_load_that_wear_relieves_is_worn_to_its_equilibrium_and_no_deeper(rate):
    """A preloaded spring pushes against the ground: wear ends where it has taken the preload, at w = F / k.

    Each cycle wears ``rate`` times what is left of that: more than twice, and the two time scales are one.
    """
    spring, preload, swing, area = 1e3, 10.0, 1e-4, 2e-6
    model = ReducedModel(
        mass=np.zeros((2, 2)),
        damping=np.zeros((2, 2)),
        stiffness=np.diag([1e9, spring]),  # what rubs is driven, what presses is the spring
        normal=[[0.0, -1.0]],
        tangential=[[1.0, 0.0]],
        load={0: [0.0, preload], 1: [1e9 * swing, 0.0]},
        pair_area=[area],
    )
    problem = ContactProblem(model, ContactLaws(friction=0.1), 50.0, 3)
    history = evolve_wear(problem, 50, rate / spring * area / (4 * swing), Tolerance(share=0.01))
    assert history.stopped is None and history.cycles[-1] == 50
    assert history.depth[-1, 0] == pytest.approx(preload / spring, rel=0.02)
    assert 0 < history.rough < 50 and f"NOT within the tolerance at {history.rough} cycles" in repr(history)


@pytest.mark.parametrize("share", [1e-1, 1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("damped", [True, False])
def test_jumped_and_every_cycle_runs_agree_within_the_tolerance(share, damped):
    """Friction, lift-off and six pairs: over three decades of tolerance."""
    cycles, problem = 300, dovetail_problem()
    every = dovetail_history(cycles)
    jumped = evolve_wear(problem, cycles, WEAR_OF_DOVETAIL, Tolerance(share=share, damped=damped))
    assert jumped.rough == 0 and "NOT" not in repr(jumped)
    error = np.abs(jumped.depth[-1] - every.depth[-1]).max() / every.depth[-1].max()
    assert error < share
    assert jumped.cycles[-1] == cycles
    if share >= 1e-3:
        assert jumped.solves < every.solves / 3


WEAR_OF_DOVETAIL = 1e-10
_history: dict[int, object] = {}


def dovetail_problem() -> ContactProblem:
    return ContactProblem(dovetail(excitation=200.0), ContactLaws(friction=0.2), 600.0, harmonics=5)


def dovetail_history(cycles: int):
    if cycles not in _history:
        _history[cycles] = evolve_wear(dovetail_problem(), cycles, WEAR_OF_DOVETAIL)
    return _history[cycles]


def test_worn_volume_is_the_integral_of_the_wear_law():
    """Per cycle ``k_w`` times the closed integral of ``lam_N |v|``, here by a quadrature of its own."""
    history = dovetail_history(300)
    total = 0.0
    for solution in history.solutions[:-1]:
        force = np.maximum(0.0, solution.history("normal_force", 4096))
        moves = classify_contact(solution, 4096) != STICK
        speed = moves * slide_behind_dashpots(solution, 4096)
        total += WEAR_OF_DOVETAIL * float(np.mean(force * speed, axis=0).sum()) / 600.0
    assert history.total_volume[-1] == pytest.approx(total, rel=1e-4)
    np.testing.assert_allclose(history.volume.sum(axis=1), history.total_volume, rtol=1e-14)


def test_only_some_pairs_wear():
    """A coefficient for each pair; pairs without a gap in their law wear not at all."""
    coefficient = np.where(np.arange(6) < 2, WEAR_OF_DOVETAIL, 0.0)
    history = evolve_wear(dovetail_problem(), 5, coefficient)
    np.testing.assert_array_equal(history.depth[-1] > 0, coefficient > 0)
    groups = [(range(3), ContactLaws(friction=0.2)), (range(3, 6), ContactLaws("bonded", "bonded"))]
    mixed = evolve_wear(ContactProblem(dovetail(excitation=200.0), groups, 600.0), 5, WEAR_OF_DOVETAIL)
    np.testing.assert_array_equal(mixed.depth[-1, 3:], 0.0)
    assert np.all(mixed.depth[-1, :3] > 0)


def test_a_joint_that_sticks_is_crossed_in_a_few_jumps():
    """Its wear is rounding; errors are to be compared with how far the load presses contact in, not with that."""
    sticking = ContactProblem(dovetail(excitation=0.5), ContactLaws(friction=0.8), 300.0, harmonics=3)
    history = evolve_wear(sticking, 500, WEAR_OF_DOVETAIL, Tolerance(share=0.01))
    assert history.cycles[-1] == 500
    assert history.depth[-1].max() < 1e-18
    assert history.solves < 30


def test_wear_stops_at_a_given_depth():
    history = evolve_wear(punch(CROWN), 500, COEFFICIENT, deepest=1e-7)
    assert history.depth[-1].max() > 1e-7 > history.depth[-2].max()
    assert "more than 1e-07 m" in history.stopped
    assert history.stopped.startswith(f"after {history.cycles[-1]} cycles")


@pytest.mark.parametrize("jump", [None, Tolerance()])
@pytest.mark.parametrize(
    "failure, why",
    [
        (UnheldBody("nothing holds a body"), "the joint no longer carries its load: nothing holds a body"),
        (NotConverged("no periodic solution at 9 Hz"), "no periodic solution at 9 Hz"),
    ],
)
def test_wear_ends_where_there_is_no_solution_and_says_which(monkeypatch, jump, failure, why):
    """Small displacements leave every worn joint an equilibrium, so the solver is made to find none past a depth."""

    def give_way(problem, *args, **kwargs):
        if problem.wear.max() > 1e-7:
            raise failure
        return solve_from(problem, *args, **kwargs)

    monkeypatch.setattr(cycle_jumps, "solve_from", give_way)
    history = evolve_wear(punch(CROWN), 500, COEFFICIENT, jump)
    assert 0.9e-7 < history.depth[-1].max() <= 1e-7 and history.cycles[-1] < 500
    assert history.stopped == f"after {history.cycles[-1]} cycles: {why}"


def test_wear_goes_on_from_a_worn_joint():
    whole = evolve_wear(punch(CROWN), 20, COEFFICIENT)
    first = evolve_wear(punch(CROWN), 12, COEFFICIENT)
    problem = punch(CROWN)
    worn = ContactProblem(problem.model, problem.laws, 100.0, harmonics=1, wear=first.depth[-1])
    np.testing.assert_allclose(evolve_wear(worn, 8, COEFFICIENT).depth[-1], whole.depth[-1], rtol=1e-9)


@pytest.mark.parametrize(
    "gap, since", [(0, "after 85 cycles, and not yet after 84"), (0.82, "from the first cycle on")]
)
def test_wear_says_when_its_motion_lost_its_stability(gap, since):
    """A mass is pressed on a stop that wears away: ``x'' + 0.05 x' + x + max(0, x - gap) = 1 + 0.6 cos 2.4 t``.

    By Runge-Kutta steps it repeats itself every period up to a gap of 0.80, and every second one from 0.82 on.
    """
    model = ReducedModel(
        mass=np.diag([1.0, 0.0, 0.0]),  # the mass, the end of its stop, and what slides there
        damping=np.diag([0.05, 0.0, 0.0]),
        stiffness=[[2.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 10.0]],
        normal=[[0.0, -1.0, 0.0]],
        tangential=[[0.0, 0.0, 1.0]],
        load={0: [1.0, 0.0, 0.0], 1: [0.6, 0.0, 1.0]},
        pair_area=[1.0],
    )
    laws = ContactLaws(tangential="frictionless", initial_gap=gap)
    history = evolve_wear(ContactProblem(model, laws, 2.4 / (2 * np.pi), 9), 100 if gap == 0 else 2, 0.1)
    stable, unstable = history.loss_of_stability
    assert 0.80 < history.gap[unstable, 0] < 0.825 and stable == (unstable - 1 if unstable else None)
    told = f"  its motion is unstable {since}: depths from there on are by a motion that does not last"
    assert told in history.summary().splitlines() and told in tell_wear(history, 1.0, 1)
    assert list_facts_of_wear(history)["wear"]["loss_of_stability_after_cycles"] == (stable, unstable)


def test_wear_whose_motion_is_stable_in_the_end_lost_nothing():
    history = evolve_wear(punch(CROWN), 2, COEFFICIENT)
    assert history.loss_of_stability is None and "unstable" not in history.summary()


@pytest.mark.slow
def test_worn_volume_does_not_depend_on_the_number_of_pairs():
    """10 and 20 pairs a flank of the blade root, the mesh elsewhere as it is; wear_pairs.py has the table with 40."""
    coarse, fine = measure_volumes(300, pairs=(10, 20))
    assert coarse["volume"] == pytest.approx(fine["volume"], rel=0.01)
    assert coarse["first_cycle"] == pytest.approx(coarse["integral"], rel=1e-4)
    assert fine["first_cycle"] == pytest.approx(fine["integral"], rel=1e-4)
    assert coarse["nodal"] / fine["nodal"] > 1.8, "by nodal force the depth would halve"


_ACCURATE = 2.0  # accuracies that the worn depth may be off: one by the jumps, one by the rates


@pytest.mark.parametrize("accuracy", [0.1, 0.03])
def test_wear_is_as_accurate_as_asked(accuracy):
    """Against 21 harmonics and finer jumps, which thirty and jumps ten times finer still change by 0.24 %.

    Here the outputs say nothing of wear.
    """
    problem = dovetail_problem()
    if "truth" not in _history:
        _history["truth"] = evolve_wear(
            replace(problem, harmonics=21), 400, WEAR_OF_DOVETAIL, Tolerance(share=1e-2), keep_every=400
        )
    true = _history["truth"].depth[-1]
    asked = evolve_wear(problem, 400, WEAR_OF_DOVETAIL, Tolerance(share=accuracy), keep_every=20, accuracy=accuracy)
    assert (asked.estimates <= accuracy).all()
    assert np.abs(asked.depth[-1] - true).max() <= _ACCURATE * accuracy * true.max()
    if accuracy < 0.1:
        crude = evolve_wear(problem, 400, WEAR_OF_DOVETAIL, Tolerance(share=1e-3), keep_every=400)
        assert estimate_errors(crude.solutions[0]).total < 0.01
        assert np.abs(crude.depth[-1] - true).max() > _ACCURATE * accuracy * true.max()
        alone = solve_to_accuracy(problem, accuracy).solution.orders[-1]
        assert asked.solutions[0].orders[-1] > alone, "the wear rate takes more harmonics than the outputs"
    table = asked.table()
    np.testing.assert_array_equal(table["estimate"], asked.estimates)
    np.testing.assert_array_equal(table["highest_harmonic"], [s.orders[-1] for s in asked.solutions])
    assert asked.output("tip").shape == (len(asked.steps), len(asked.orders))


def wear_to_a_tenth(**settings):
    return evolve_wear(
        dovetail_problem(), 3000, WEAR_OF_DOVETAIL, Tolerance(share=0.1), keep_every=150, accuracy=0.1, **settings
    )


def test_harmonics_are_raised_when_a_worn_joint_needs_more(tmp_path, monkeypatch):
    """And a run that is broken off there and taken up again is the unbroken one, byte for byte."""
    whole = wear_to_a_tenth(file=tmp_path / "whole.h5")
    tops = [s.orders[-1] for s in whole.solutions]
    assert tops[0] < tops[-1], "the fresh joint took fewer"
    assert (whole.estimates <= 0.1).all()
    assert (np.diff(whole.depth, axis=0) >= 0).all()

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        count_calls(patch, cycle_jumps.WearRun, "advance", 5)
        wear_to_a_tenth(file=tmp_path / "broken.h5")
    resumed = wear_to_a_tenth(file=tmp_path / "broken.h5")
    assert [s.orders[-1] for s in resumed.solutions] == tops
    assert (tmp_path / "broken.h5").read_bytes() == (tmp_path / "whole.h5").read_bytes()
