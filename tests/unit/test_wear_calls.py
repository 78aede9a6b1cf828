"""What ``evolve_wear`` refuses before it solves anything, and its file: read again, damaged, or not to be written."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from counted_calls import count_calls
from small_models import dovetail, lift_off_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, Tolerance, evolve_wear, solve, solve_to_accuracy
from ewr_fenicsx.errors import ModelError, NotConverged
from ewr_fenicsx.runs.findings import list_facts_of_wear, tell_wear
from ewr_fenicsx.wear import cycle_jumps
from ewr_fenicsx.wear.archard import measure_wear_rate
from ewr_fenicsx.wear.wear_accuracy import AccurateWear
from ewr_fenicsx.wear.wear_store import Leap, TriedModels, WearStep

WEAR = 1e-10


def pose() -> ContactProblem:
    return ContactProblem(dovetail(excitation=200.0), ContactLaws(friction=0.2), 600.0, harmonics=5)


def test_a_joint_that_cannot_wear_is_refused():
    with pytest.raises(ModelError, match="no pair can wear"):
        evolve_wear(pose(), 5, 0.0)
    bonded = ContactProblem(dovetail(), ContactLaws("bonded", "bonded"), 600.0)
    with pytest.raises(ModelError, match='normal = "unilateral"'):
        evolve_wear(bonded, 5)
    with pytest.raises(ModelError, match="one for each of 6 pairs"):
        evolve_wear(pose(), 5, -1.0)
    glued = ContactLaws(tangential="bonded")
    with pytest.raises(ModelError, match=r'no pair can wear: .* and slide \(tangential = "coulomb"'):
        evolve_wear(replace(pose(), laws=glued), 5, WEAR)


def test_pairs_whose_bonds_let_nothing_slide_have_no_wear_coefficient():
    laws = [([0, 1, 2, 3], ContactLaws(friction=0.2)), ([4, 5], ContactLaws(tangential="bonded"))]
    history = evolve_wear(replace(pose(), laws=laws), 1, WEAR)
    np.testing.assert_array_equal(history.coefficient, WEAR * np.array([1, 1, 1, 1, 0, 0]))


def test_wear_without_the_areas_of_pairs_takes_ones_and_says_so():
    """With areas of one in their place depths were off by four orders of magnitude, without a word."""
    model = dovetail(excitation=200.0)
    without = replace(pose(), model=replace(model, pair_area=None))
    with pytest.warns(
        UserWarning, match=r"pair_area was not given: each pair is taken to have an area of 1 m\^2"
    ) as told:
        worn = evolve_wear(without, 2, 1e-6 * WEAR)
    assert told[0].filename == __file__, "it is the caller's to mend"
    ones = evolve_wear(replace(without, model=replace(model, pair_area=np.ones(6))), 2, 1e-6 * WEAR)
    np.testing.assert_array_equal(worn.depth, ones.depth)
    np.testing.assert_array_equal(worn.volume, ones.volume)
    assert worn.depth[-1].max() > 0
    solution, one = solve(pose()), np.full(6, WEAR)
    np.testing.assert_allclose(
        measure_wear_rate(solve(without), one), measure_wear_rate(solution, one) * model.pair_area, rtol=1e-12
    )


@pytest.mark.parametrize("jump, deepest", [(None, None), (Tolerance(), None), (Tolerance(), 1e-9)])
def test_a_joint_that_does_not_slide_is_solved_once(jump, deepest):
    """Every cycle was solved to add nothing."""
    history = evolve_wear(replace(pose(), laws=ContactLaws(friction=20.0)), 1000, WEAR, jump, deepest=deepest)
    assert history.solves == 1 and list(history.cycles) == [0, 1000]
    assert not np.any(history.depth) and history.stopped is None
    lines = tell_wear(history, 1.0, 5)
    assert "  nothing wears from cycle 0 on: no pair that may wear slides while it is pressed" in lines
    assert not any("as they land" in line for line in lines)


@pytest.mark.parametrize("tangents", [1, 2])
@pytest.mark.parametrize("static_friction", ["resolved", "held"])
def test_what_sticks_by_its_mean_friction_alone_does_not_creep_into_wear(tangents, static_friction):
    """Its mean equation leaves it 1e-7 of its motion: the error of that was told, and took all harmonics there are."""
    each, shear = np.eye(1 + tangents), [0.3, 0.1j][:tangents]
    model = ReducedModel(
        mass=0.1 * each,
        damping=0.02 * each,
        stiffness=each,
        normal=each[:1],
        tangential=each[1:],
        load={0: -each[0], 1: np.array([-0.8, *shear])},
        pair_area=[0.5],
    )
    pad = ContactProblem(model, ContactLaws(friction=0.5, static_friction=static_friction), 0.05, 5)
    history = evolve_wear(pad, 100, 1e-3, Tolerance())
    assert abs(history.solutions[0].pair_forces["tangential"][0, 0]) > 0.15
    assert history.solves == 1 and not np.any(history.depth) and "NOT accurate" not in history.summary()
    assert history.solutions[0].merit["J_T"] == 0.0
    accurate = evolve_wear(pad, 100, 1e-3, Tolerance(), accuracy=0.05)
    assert not accurate.short.size and accurate.solutions[-1].orders[-1] < 10
    slides = solve(replace(pad, laws=replace(pad.laws, friction=0.1)))
    assert measure_wear_rate(slides, np.ones(1)) > 0.01


def test_pairs_that_slide_while_they_are_open_may_rub_as_they_land():
    """Few harmonics see them stick at once: of a small wear nothing is left."""
    model = replace(lift_off_oscillator(excitation=1.5), pair_area=[0.5])
    tapping = ContactProblem(model, ContactLaws(friction=20.0), 0.2, 5)
    few, many = (evolve_wear(replace(tapping, harmonics=n), 3, 1e-3) for n in (5, 31))
    told = "  pairs slide while they are open; more harmonics may show that they rub as they land"
    assert not np.any(few.rate) and told in few.summary().splitlines()
    assert np.all(many.rate[-1] > 0) and told not in many.summary().splitlines()


def test_pairs_that_do_not_rub_for_want_of_harmonics_are_not_as_accurate_as_asked():
    """Wear of nothing was told as accurate within 9 %, with 25 harmonics; with 31 pairs rub as they land."""
    model = replace(lift_off_oscillator(excitation=1.5), pair_area=[0.5])
    tapping = ContactProblem(model, ContactLaws(friction=20.0), 0.2)
    history = evolve_wear(tapping, 1, 1e-3, accuracy=0.1, highest=25)
    assert not np.any(history.rate) and history.estimates[0] > 0.5
    assert history.short[0] == 0 and "NOT as accurate as asked" in history.summary()


def pose_fading_resonance() -> ContactProblem:
    """A mass above the resonance that its stop bends to it: as a slider wears the stop away, that motion ends."""
    stiffness = np.zeros((4, 4))  # of the mass, the end of its stop, what slides, and a foot that carries a load
    stiffness[:2, :2], stiffness[2, 2], stiffness[3, 3] = [[2.0, -1.0], [-1.0, 1.0]], 100.0, 1.0
    model = ReducedModel(
        mass=np.diag([1.0, 0.0, 0.0, 0.0]),
        damping=np.diag([0.04, 0.0, 0.0, 0.0]),
        stiffness=stiffness,
        normal=[[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, -1.0]],
        tangential=[[0.0, 0.0, 1.0, 0.0]] * 2,
        load={0: [0.0, 0.0, 0.0, 1.0], 1: [0.08, 0.0, 10.0, 0.0]},
        outputs={"tip": [1.0, 0.0, 0.0, 0.0]},
        pair_area=[1.0, 1.0],
    )
    stop = ContactLaws(tangential="frictionless", initial_gap=0.5)
    return ContactProblem(model, [([0], stop), ([1], replace(stop, initial_gap=0.0))], 0.1705, 15)


@pytest.mark.parametrize("jump", [None, Tolerance(share=0.01)])
def test_a_joint_that_leaps_to_another_motion_while_it_wears_says_so(jump):
    """Its amplitude fell to a third from one cycle to the next, without a word."""
    history = evolve_wear(pose_fading_resonance(), 150, np.array([0.05, 1e-4]), jump)
    before, after = (history.figure("rms_tip")[history.cycles == cycle] for cycle in (142, 143))
    assert after < 0.3 * before
    (leap,) = history.leaps
    assert (leap.cycle, leap.found_by) == (142, "cold start")
    tip = [np.abs(history.output("tip")[history.cycles == cycle, 1:]).ravel() for cycle in (142, 143)]
    assert leap.change >= np.linalg.norm(tip[0] - tip[1]) / np.linalg.norm(tip[0]) > 0.5
    told = (
        "  after 142 cycles the motion led nowhere: wear goes on from a solution found otherwise (cold start), whose "
        f"outputs differ by {100 * leap.change:.3g}%"
    )
    assert told in history.summary().splitlines() and told in tell_wear(history, 1.0, 4)
    facts = {"cycle": 142, "found_by": "cold start", "change": leap.change}
    assert list_facts_of_wear(history)["wear"]["leaps"] == [facts]


def test_a_joint_that_keeps_its_motion_leaps_nowhere():
    """Though its first solution was found by a fallback as well."""
    history = evolve_wear(pose_fading_resonance(), 20, np.array([0.05, 1e-4]))
    assert history.solutions[0].fallbacks and history.leaps == () and "led nowhere" not in history.summary()
    assert list_facts_of_wear(history)["wear"]["leaps"] == []


def test_leaps_share_a_line():
    history = evolve_wear(pose(), 2, WEAR)
    leaps = tuple(Leap(3 * k, ("cold start", "time stepping")[k % 2], 0.1 * k) for k in range(1, 8))
    assert replace(history, leaps=leaps).list_outcome()[1:] == [
        "  after 7 steps from 3 to 21 cycles the motion led nowhere: wear goes on from a solution found otherwise "
        "(time stepping, cold start), whose outputs differ by up to 70%"
    ]


def test_a_resumed_run_knows_of_the_leaps_before(tmp_path, monkeypatch):
    run = lambda name: evolve_wear(pose_fading_resonance(), 150, np.array([0.05, 1e-4]), file=tmp_path / name)  # noqa: E731
    whole = run("whole.h5")
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        count_calls(patch, cycle_jumps, "solve_from", 145)
        run("broken.h5")
    assert run("broken.h5").leaps == whole.leaps != ()
    assert (tmp_path / "broken.h5").read_bytes() == (tmp_path / "whole.h5").read_bytes()


def test_a_leap_to_a_solution_that_is_accurate_enough_is_told(monkeypatch):
    """Where the one that was kept was not, a fallback may have found the other."""

    def look_elsewhere(judge, step):
        if step.cycle != 2:
            return replace(step, estimate=0.1)
        return replace(step, estimate=0.1, solution=replace(step.solution, fallbacks=("given start: no", "cold: yes")))

    monkeypatch.setattr(AccurateWear, "look_at", look_elsewhere)
    history = evolve_wear(pose(), 3, WEAR, accuracy=0.5)
    assert [(leap.cycle, leap.found_by) for leap in history.leaps] == [(1, "cold")]
    assert 0 < history.leaps[0].change < 0.1


@pytest.mark.parametrize("cycles, told", [(2, "1, 2"), (7, "7 steps from 1 to 7")])
def test_steps_that_fall_short_share_a_line(cycles, told):
    history = evolve_wear(pose(), cycles, WEAR)
    steps = (history.steps[0], *(replace(step, estimate=0.2) for step in history.steps[1:]))
    lines = tell_wear(replace(history, steps=steps, accuracy=0.1), 1.0, 5)
    assert f"  NOT as accurate as asked at {told} cycles" in lines


def test_a_summary_tells_how_far_off_a_cycle_may_be():
    """As the looked-for error shows with many harmonics; with an accuracy it is that of all steps."""
    few, many = (evolve_wear(replace(pose(), harmonics=n), 2, WEAR) for n in (3, 31))
    line = few.summary().splitlines()[1]
    told = float(re.search(r"in the end .*estimated error of the outputs and the wear rate ([\d.]+)", line)[1])
    off = np.linalg.norm(few.rate[-1] - many.rate[-1]) / np.linalg.norm(many.rate[-1])
    assert off / 5 < told < 5 * off
    assert few.summary().startswith("2 cycles in 3 solves: deepest ")
    accurate = evolve_wear(pose(), 2, WEAR, accuracy=0.05)
    assert f"  estimated errors up to {accurate.estimates.max():.1g} of 0.05 asked" in accurate.summary().splitlines()


def test_the_mean_depth_is_the_volume_over_the_area():
    """Pairs stand for areas of their own: at the ends of a flank for half of the others'."""
    history = evolve_wear(pose(), 2, WEAR)
    table = history.table()
    assert (
        repr(history)
        == f"WearHistory({len(history.steps)} steps to cycle 2 in {history.solves} solves, to the last one)"
    )
    np.testing.assert_allclose(table["mean depth [m]"] * dovetail().pair_area.sum(), table["volume [m^3]"], rtol=1e-14)
    assert table["volume [m^3]"][-1] > 0


def test_a_figure_that_there_is_none_of_is_named():
    with pytest.raises(ModelError, match=r'no figure "J_S"; there are .*; did you mean "J_T"'):
        evolve_wear(pose(), 1, WEAR).figure("J_S")


def test_nothing_wears_at_rest():
    at_rest = replace(pose(), frequency=0.0, load={0: dovetail().load[0]})
    with pytest.raises(ModelError, match="no pair can wear: frequency = 0 Hz"):
        evolve_wear(at_rest, 5, WEAR)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"coefficient": [1e-11, 1e-11]}, "wear coefficient has 2 values for 6 pairs; give one, or one a pair"),
        ({"coefficient": 1e300}, "wear coefficient 1e[+]300; give one from 0 to 1e100 in 1/Pa"),
        ({"coefficient": "steel"}, "wear coefficient = 'steel'; give numbers"),
        ({"cycles": 2.5}, "cycles = 2.5, .*; give whole numbers from 1"),
        ({"cycles": np.inf}, "cycles = inf, .*; give whole numbers from 1"),
        ({"cycles": "many"}, "cycles = 'many', .*; give whole numbers from 1"),
        ({"cycles": 10**20}, "cycles = 100000000000000000000, .*, and up to 1e.12 cycles"),
        ({"keep_every": 0}, "keep_every = 0, .*; give whole numbers from 1"),
        ({"deepest": -1}, r"deepest = -1; give a positive depth \[m\], or None"),
        ({"deepest": np.nan}, "deepest = nan; give a positive depth"),
        ({"jump": 0.01}, r"jump = 0.01; give Tolerance\(share=0.01\) or the like, or None"),
        ({"accuracy": "x"}, "accuracy = 'x'; give a relative error between 0 and 1"),
        ({"cycle": 5}, 'cycle: no argument of evolve_wear; did you mean "cycles"'),
        ({"harmonics": 9}, "harmonics: no argument of evolve_wear$"),
        ({"first": 9}, "first: no argument of evolve_wear"),
        ({"highest": 9}, "highest: only where an accuracy is asked for; give accuracy=... or leave them out"),
        ({"problem": dovetail()}, r"problem = ReducedModel\(.*; give ContactProblem\("),
    ],
)
def test_what_makes_no_wear_calculation_is_refused(arguments, message):
    with pytest.raises(ModelError, match=message):
        evolve_wear(**{"problem": pose()} | arguments)


@pytest.mark.parametrize("arguments", [{"share": 0}, {"share": 5}, {"share": "x"}, {"first": 2.5}, {"depth": np.inf}])
def test_what_makes_no_tolerance_is_refused(arguments):
    with pytest.raises(ModelError, match="positive, share below 1, first a whole number of at least 1 cycle"):
        Tolerance(**arguments)


def test_a_tolerance_that_does_not_say_of_what_is_refused():
    with pytest.raises(TypeError, match="positional"):
        Tolerance(0.01)  # a share in a scene, but 10 mm here


def test_what_an_accuracy_of_wear_cannot_mean():
    with pytest.raises(ModelError, match="between 0 and 1"):
        evolve_wear(pose(), 5, WEAR, accuracy=2.0)
    with pytest.raises(ModelError, match="modes: only where an accuracy is asked for"):
        evolve_wear(pose(), 5, WEAR, modes=[0])
    with pytest.raises(ModelError, match=r'higest: no argument of evolve_wear; did you mean "highest"'):
        evolve_wear(pose(), 5, WEAR, accuracy=0.1, higest=9)
    with pytest.raises(ModelError, match="figure: no argument of evolve_wear"):
        evolve_wear(pose(), 5, WEAR, accuracy=0.1, figure=print)


def test_weights_of_the_problem_are_kept_where_wear_is_judged_anew():
    """A solution that was found with default weights only is left, and not for good."""
    problem = replace(pose(), rho_normal=1e6, rho_tangential=50.0)
    judge = AccurateWear(problem, 10, np.full(6, WEAR), 1e-6, 1e-8, {"highest": 6}, TriedModels(problem))
    went_back = solve(replace(problem, rho_normal=None, rho_tangential=None))
    asked = []
    judge._solve = lambda posed, start, first: asked.append(posed) or solve_to_accuracy(posed, 0.5)
    judge.look_at(WearStep(0, np.zeros(6), np.zeros(6), went_back))
    assert [(posed.rho_normal, posed.rho_tangential) for posed in asked] == [(1e6, 50.0)]


def test_a_jump_without_a_near_solution_is_shortened_and_does_not_grow_at_once(monkeypatch):
    """The ladder takes far longer than a shorter jump, which is a nearer start."""
    follow, solve_cold, lost, given = cycle_jumps.solve_from, cycle_jumps.solve, [], []

    def lose_long_jumps(problem, latest, earlier, ratio, tolerance):
        lost.append(np.abs(problem.wear - latest.problem.wear).max() > reach)
        found = follow(problem, latest, earlier, ratio, tolerance)
        return replace(found, converged=False, reason="lost") if lost[-1] else found

    def solve(problem, start=None, tolerance=1e-8):
        given.append(start)
        return solve_cold(problem, start, tolerance)

    free = evolve_wear(pose(), 60, WEAR, Tolerance(share=0.2))
    reach = 6 * free.steps[0].rate.max()
    monkeypatch.setattr(cycle_jumps, "solve_from", lose_long_jumps)
    monkeypatch.setattr(cycle_jumps, "solve", solve)
    held = evolve_wear(pose(), 60, WEAR, Tolerance(share=0.2))
    assert given == [None], "the first solve, and no other"
    assert np.diff(free.cycles).max() > 6 >= np.diff(held.cycles).max() > 1 and held.cycles[-1] == 60
    assert 0 < sum(lost) <= len(held.steps) / 2 + 1, "the step after a shortened one is as short"
    np.testing.assert_allclose(held.depth[-1], free.depth[-1], rtol=0.1)


def test_a_jump_over_a_quarter_of_all_cycles_may_be_off_by_half_of_the_tolerance():
    run = cycle_jumps.WearRun(pose(), 400, np.full(6, WEAR), Tolerance(depth=1e-6), 1, None, 1e-8, None)
    here = run.begin().latest
    assert run._allowed(here, replace(here, cycle=100), np.zeros((6, 6))) == pytest.approx(5e-7, rel=1e-12)


@pytest.mark.parametrize("share", [0.001, 0.01])
def test_jumps_stop_where_single_cycles_do(share):
    """They ran on to nearly four times the depth that was to end them."""
    usual, jumps = (evolve_wear(pose(), 30000, WEAR, jump, deepest=2e-6) for jump in (None, Tolerance(share=share)))
    assert abs(jumps.cycles[-1] - usual.cycles[-1]) <= 1 and len(jumps.steps) < len(usual.steps) / 3
    assert 2e-6 < jumps.depth[-1].max() <= 2e-6 + 1.5 * jumps.rate[-1].max()
    assert "more than 2e-06 m" in jumps.stopped and jumps.depth[-2].max() < 2e-6


def test_a_single_cycle_takes_every_fallback(monkeypatch):
    """No shorter jump can replace it."""
    follow = cycle_jumps.solve_from
    usual = evolve_wear(pose(), 3, WEAR)
    monkeypatch.setattr(
        cycle_jumps, "solve_from", lambda *given: replace(follow(*given), converged=False, reason="lost")
    )
    for jump in (None, Tolerance(first=1)):
        lost = evolve_wear(pose(), 3, WEAR, jump)
        assert lost.stopped is None and lost.cycles[-1] == 3
        np.testing.assert_allclose(lost.depth[-1], usual.depth[-1], rtol=1e-6)


def stop_after(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """No solution from so many solves on, neither near the last one nor by fallbacks."""
    follow, calls = cycle_jumps.solve_from, []

    def lose(*given):
        calls.append(given)
        found = follow(*given)
        return found if len(calls) <= most else replace(found, converged=False, reason="lost")

    def refuse(*_):
        raise NotConverged("no periodic solution", best=None)

    monkeypatch.setattr(cycle_jumps, "solve_from", lose)
    monkeypatch.setattr(cycle_jumps, "solve", refuse)


@pytest.mark.parametrize("why", ["has worn", "no periodic solution"])
def test_the_last_step_of_wear_that_ends_early_is_as_accurate_as_asked(why, monkeypatch):
    """It had no estimate, and was over the accuracy that the summary said was reached."""
    if why == "no periodic solution":
        stop_after(13, monkeypatch)
    deepest = 3.38e-5 if why == "has worn" else None
    jump = Tolerance(share=0.1)
    history = evolve_wear(pose(), 3000, WEAR, jump, keep_every=3000, accuracy=0.1, deepest=deepest)
    assert len(history.steps) == 2 and why in history.stopped
    last = history.steps[-1]
    many = solve(replace(last.solution.problem, harmonics=41, samples=None), last.solution)
    exact = measure_wear_rate(many, history.coefficient)
    assert np.abs(last.rate - exact).max() <= 0.1 * exact.max() and last.estimate <= 0.1
    assert last.solution.orders[-1] > history.solutions[0].orders[-1], "those of the start no longer do"
    np.testing.assert_array_equal(last.rate, measure_wear_rate(last.solution, history.coefficient))
    told = {"asked": 0.1, "reached": True, "estimate": {"total": history.estimates.max()}, "short_after_cycles": []}
    assert list_facts_of_wear(history)["accuracy"] == told


def test_wear_that_ends_early_short_of_its_accuracy_says_so():
    history = evolve_wear(
        pose(), 3000, WEAR, Tolerance(share=0.1), accuracy=0.1, deepest=3.38e-5, keep_every=3000, highest=3
    )
    assert history.estimates[-1] > 0.1 and history.short.tolist() == history.cycles[-1:].tolist()
    assert not list_facts_of_wear(history)["accuracy"]["reached"]


def test_wear_that_falls_short_of_its_accuracy_says_so():
    """A limit of five harmonics; without an accuracy there is nothing to fall short of."""
    history = evolve_wear(pose(), 3, WEAR, accuracy=1e-6, highest=5)
    assert history.short.tolist() == [0, 1, 2, 3] and "NOT as accurate as asked at 4 of the steps" in repr(history)
    for kept in (evolve_wear(pose(), 3, WEAR), evolve_wear(pose(), 3, WEAR, accuracy=0.9)):
        assert kept.short.size == 0 and "NOT" not in repr(kept)
