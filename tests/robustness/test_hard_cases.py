"""Hard cases, cold: each ends in a solution or says why not; nearly all converge."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import replace
from functools import cache

import hard_cases
import numpy as np
import pytest
from hard_cases import draw_cases, run_sampled
from models import blade_root
from reporting import RESULTS

from ewr_fenicsx import ContactLaws, ContactProblem, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.errors import NotConverged
from ewr_fenicsx.response.solution_store import restore, strip
from ewr_fenicsx.solver import growing_load, ladder, newton, newton_path, snes, time_integration, weights
from ewr_fenicsx.solver.growing_sets import sample_anew
from ewr_fenicsx.solver.snes import Attempt


def run_sample(
    counts: dict[str, int], cap: float, highest: int = 31, seed: int = 101
) -> tuple[list[hard_cases.Outcome], list[hard_cases.Outcome]]:
    """Outcomes of a sample of cases: those with the default weights, and those with weights a thousandfold off."""
    cases = [case for i, (name, count) in enumerate(counts.items()) for case in draw_cases(name, count, seed + i)]
    outcomes = [(case.rho == (1, 1), run_sampled((case, cap))) for case in cases if case.harmonics <= highest]
    return [o for usual, o in outcomes if usual], [o for usual, o in outcomes if not usual]


def describe(outcomes: list[hard_cases.Outcome]) -> str:
    return "\n".join(f"{o.status}: {o.name}: {o.reason}" for o in outcomes)


def check_outcomes(outcomes: list[hard_cases.Outcome]) -> list[hard_cases.Outcome]:
    """Every case ends with a solution or a reason; returns those with a solution."""
    odd = [o for o in outcomes if o.status not in ("converged", "not converged")]
    assert not odd, describe(odd)
    unexplained = [o for o in outcomes if o.status == "not converged" and not (o.reason and np.isfinite(o.residual))]
    assert not unexplained, describe(unexplained)
    solved = [o for o in outcomes if o.status == "converged"]
    assert max(o.residual for o in solved) <= 1.01 * hard_cases.TOLERANCE
    return solved


def check_share(outcomes: list[hard_cases.Outcome], share: float, steps: float) -> None:
    """``share`` of the cases converge, in ``steps`` on average."""
    solved = check_outcomes(outcomes)
    assert len(solved) >= share * len(outcomes), describe([o for o in outcomes if o.status != "converged"])
    assert np.mean([o.steps for o in solved]) <= steps


def test_a_small_sample():
    """Up to nine harmonics, so that no machine is too slow for the cap."""
    usual, off = run_sample({"blade root": 12, "dovetail": 24, "lap joint": 24}, cap=600.0, highest=9)
    check_share(usual, share=1.0, steps=15.0)
    assert len(check_outcomes(off)) >= 0.9 * len(off)


STORED = json.loads((RESULTS / "hard_cases.json").read_text())


@cache
def run_large_sample() -> list[hard_cases.Outcome]:
    """The stored one."""
    usual, off = run_sample(dict.fromkeys(hard_cases.MODELS, 108), cap=60.0, seed=STORED["seed"])
    return usual + off


@pytest.mark.slow
def test_a_large_sample_does_not_fall_behind():
    """Hardly a case is lost that was solved, but for what a slow machine may give up at the cap."""
    outcomes = run_large_sample()
    given_up = [o for o in outcomes if o.status == "given up"]
    assert len(given_up) <= 0.015 * len(outcomes), describe(given_up)
    solved = check_outcomes([o for o in outcomes if o.status != "given up"])
    failed = [o["name"] for o in STORED["failures"]]
    lost = [o for o in outcomes if o.status == "not converged" and o.name not in failed]
    assert len(lost) <= 0.01 * len(outcomes), describe(lost)
    assert np.median([o.steps for o in solved]) <= 12 and np.mean([o.steps for o in solved]) <= 50


@pytest.mark.slow
@pytest.mark.xfail(
    strict=True,
    raises=AssertionError,
    reason="target not reached: 99.5 % in 15 steps on average; flanks that bounce, and weights a thousandfold off",
)
def test_a_large_sample():
    solved = [o for o in run_large_sample() if o.status == "converged"]
    assert len(solved) >= 0.995 * len(run_large_sample())
    assert np.mean([o.steps for o in solved]) <= 15.0


def test_the_sample_has_every_level_equally_often():
    cases = draw_cases("dovetail", 36, seed=5)
    assert cases == draw_cases("dovetail", 36, seed=5) != draw_cases("dovetail", 36, seed=6)
    for name, levels in hard_cases.DIMENSIONS.items():
        seen = [getattr(case, name) for case in cases]
        for level in set(levels):
            assert abs(seen.count(level) - 36 * levels.count(level) / len(levels)) < 2, (name, level)


def test_a_case_that_takes_too_long_is_given_up():
    outcome = run_sampled((replace(draw_cases("dovetail", 1, seed=1)[0], load=("reached", 3.0), friction=0.05), 0.0))
    assert (outcome.status, outcome.steps) == ("given up", 0)
    assert HarmonicBalance.linearise.__name__ == "linearise"  # the counter is gone


@pytest.mark.parametrize(
    ("case", "most"),
    [
        (("lap joint", 0.85, ("reached", 0.3), 0.6, 3, 0.05, "even"), 50),
        (("dovetail", 1.05, ("reached", 3.0), 0.6, 9, 1e-4, "closed"), 100),
        (("blade root", 0.95, ("reached", 1.0), 1.5, 3, 1e-3, "closed"), 200),
    ],
    ids=["lap joint", "dovetail", "blade root"],
)
def test_next_to_a_corner_a_cold_start_goes_on_or_the_ladder_does(monkeypatch, case, most):
    """Near resonances with much friction: over corners, or by other ways, as with laws that do not tell theirs."""
    problem = hard_cases.pose_case(hard_cases.Case(*case, (1, 1)))
    solution = solve(problem, fallbacks=False)
    assert hard_cases.judge(solution)[0] == "converged" and solution.iterations < 150
    for module in (newton_path, ladder, newton):
        monkeypatch.setattr(module, "can_follow", lambda _: False)
    without = solve(replace(problem), fallbacks=False, raise_on_failure=False)
    assert not without.converged
    around = solve(replace(problem))
    assert hard_cases.judge(around)[0] == "converged" and around.iterations < most


@pytest.mark.slow
def test_more_sets_of_harmonics_lead_to_a_solution_in_a_large_joint(monkeypatch):
    """With 40 pairs and 15 harmonics, also where time stepping, the only other way on, ends nowhere."""
    case = hard_cases.Case("blade root", 1.05, ("reached", 1.0), 1.5, 15, 1e-3, "closed", (1, 1))
    problem = hard_cases.pose_case(case)
    for barred in (False, True):
        if barred:
            monkeypatch.setattr(newton, "step_coarsely", lambda _: "barred")
        solution = solve(replace(problem))
        assert hard_cases.judge(solution)[0] == "converged" and solution.iterations < 150
    assert solution.fallbacks[-1].startswith("more sets of harmonics")


@pytest.mark.parametrize(
    ("case", "most"),
    [
        (("dovetail", 1.0, ("reached", 3.0), 1.5, 9, 1e-4, "half open", (1, 1)), 60),
        (("lap joint", 0.95, ("reached", 3.0), 0.6, 31, 5e-3, "closed", (1e3, 1e3)), 100),
        (("blade root", 3.0, ("reached", 0.01), 0.01, 3, 5e-3, "closed", (1, 1e3)), 60),
        (("dovetail", 2.0, ("reached", 1.0), 1.5, 9, 5e-2, "even", (1e-3, 1e-3)), 60),
    ],
    ids=lambda given: f"{given[0]}-{given[4]}" if isinstance(given, tuple) else None,
)
def test_newtons_path_takes_a_fraction_of_the_steps(monkeypatch, case, most):
    """Where runs stalled and walks of hundreds of steps, or more sets of harmonics, were the ways on."""
    problem = hard_cases.pose_case(hard_cases.Case(*case))
    solution = solve(problem)
    assert hard_cases.judge(solution)[0] == "converged" and solution.iterations <= most
    assert solution.problem.rho_tangential is problem.rho_tangential
    monkeypatch.setattr(newton_path, "can_follow", lambda _: False)
    assert solve(replace(problem)).iterations > 2 * solution.iterations


@pytest.mark.parametrize(
    "case",
    [
        hard_cases.Case("dovetail", 1 / 3, ("reached", 3.0), 1.5, 1, 0.02, "even", (1, 1)),
        hard_cases.Case("dovetail", 0.5, ("reached", 3.0), 1.0, 1, 0.05, "even", (1, 1)),
        hard_cases.Case("lap joint", 3.0, ("applied", 0.1), 0.6, 3, 0.005, "random", (1, 1)),
        hard_cases.Case("dovetail", 1.0, ("applied", 0.03), 0.2, 15, 1e-4, "even", (1, 1)),
        hard_cases.Case("blade root", 0.3, ("reached", 1.0), 1.5, 5, 0.005, "even", (1, 1)),
        hard_cases.Case("blade root", 1.5, ("reached", 3.0), 0.6, 3, 0.05, "random", (1, 1)),
    ],
    ids=lambda case: f"{case.model}-{case.frequency:.2g}",
)
def test_the_load_grows_over_corners(case):
    """From next to no load, where it is no hard case; rounded corners took 400 to 500 steps in the first two."""
    problem = hard_cases.pose_case(case)
    balance = HarmonicBalance(problem.system)
    found = growing_load.grow_load(balance, 1e-8, ladder.begin_at_full_stick(balance))
    assert found.converged and found.iterations <= 45 and "grown from corner to corner" in found.reason
    assert np.linalg.norm(balance.residual(found.unknowns)) <= 1e-8
    rungs = [name for name, _ in newton.list_rungs(problem, balance, None, 1e-8, "elimination")]
    assert rungs[1:4] == ["time stepping", "load grown over corners", "more harmonics, then fewer"]
    assert rungs[4] == "rounded corners"


def test_a_path_past_matrices_that_are_all_but_singular_stays_on_its_way():
    """Rounding took it from there: what it ended with left 2e-5 to 10, as the machine had it."""
    case = hard_cases.Case("blade root", 0.7, ("reached", 1.0), 1.5, 9, 0.05, "even", (1, 1))
    few = sample_anew(HarmonicBalance(hard_cases.pose_case(case).system), 32)
    first, begun = growing_load._begin_with_little_load(few, 1e-8)
    found = newton_path.follow_path(few.firm, begun.unknowns, 1e-8, 10_000, first, tried=10_000)
    assert found.residual < 1e-6 and found.iterations > 2


def test_mean_friction_of_pairs_that_stick_does_not_depend_on_the_way(monkeypatch):
    """By a thousandth of all forces it did: a residual of 1e-10 was left of that, and a line search took no step."""
    problem = ContactProblem(blade_root(), ContactLaws(friction=0.05), 1400.0, 5, closure="dashpot")
    split = solve(problem, fallbacks=False)
    monkeypatch.setattr(ladder, "can_split", lambda _: False)
    climbed = solve(problem, fallbacks=False)
    assert np.any(split.forces != climbed.forces), "two ways"
    np.testing.assert_allclose(split.forces, climbed.forces, rtol=0, atol=1e-6 * np.linalg.norm(climbed.forces))


def test_many_harmonics_take_as_few_steps_as_few():
    """At 37 kHz the structure's answer to a splitting grew 25 times, and it diverged: nine steps in place of none."""
    taken = {
        n: solve(ContactProblem(blade_root(), ContactLaws(friction=0.2), 1000.0, n), tolerance=1e-3) for n in (31, 39)
    }
    assert all(found.iterations <= 2 and not found.fallbacks for found in taken.values())
    np.testing.assert_allclose(taken[39].output("tip")[1], taken[31].output("tip")[1], rtol=1e-2)


def test_far_off_a_splitting_does_not_look_back_far():
    """States of twenty iterations ago led it astray: it ended at a defect of 1.6e-2, and Newton's method nowhere."""
    demo = blade_root()
    load = {h: f * (2.0 if h else 1.0) for h, f in demo.load.items()}
    problem = ContactProblem(demo, ContactLaws(friction=0.4), 1000.0, 5, load=load, closure="dashpot")
    assert solve(problem, fallbacks=False).iterations <= 10


@pytest.mark.parametrize("rho", [(1e3, 1e3), (1e-3, 1e-3), (1.0, 1e-3)])
def test_weights_far_off_are_approached_from_the_defaults(rho):
    """Gross lift-off, which no way by itself finds with such weights; the answer is the asked problem's own.

    What the solution with the default weights took is told.
    """
    case = hard_cases.Case("dovetail", 1.05, ("reached", 3.0), 1.5, 5, 0.005, "random", rho)
    problem = hard_cases.pose_case(case)
    solution = solve(problem)
    balance = HarmonicBalance(problem.system)
    assert np.linalg.norm(balance.residual(balance.pack(solution.forces, solution.rigid))) <= 1e-8
    usual = solve(replace(problem, rho_normal=None, rho_tangential=None))
    assert np.linalg.norm(balance.residual(balance.pack(usual.forces, usual.rigid))) > 1e-6
    assert usual.fallbacks and all(rung in solution.fallbacks[0] for rung in usual.fallbacks)
    alone = solve(problem, fallbacks=False, raise_on_failure=False)
    assert not alone.converged and alone.iterations < solution.iterations and alone.fallbacks == ()
    with pytest.raises(NotConverged, match="no periodic solution") as refused:
        solve(problem, usual, fallbacks=False)
    assert "Tried" not in str(refused.value)


def test_where_nothing_leads_to_weights_far_off_the_default_ones_take_their_place(monkeypatch):
    """The answer says so, and is kept with the weights that it holds for. Rounding decides whether a walk leads on."""
    case = hard_cases.Case("dovetail", 0.85, ("reached", 1.0), 0.2, 5, 0.02, "closed", (1e-3, 1e-3))
    problem = hard_cases.pose_case(case)
    lost = lambda *_: Attempt(np.zeros(0), np.inf, 0, "as if", False)  # noqa: E731
    for way in ("split_at_length", "follow_from_afar", "walk_weights"):
        monkeypatch.setattr(weights, way, lost)
    solution = solve(problem)
    assert "from the default weights and dashpots: solved with these only: as if" in solution.summary()
    assert solution.problem.rho_normal is solution.problem.rho_tangential is None
    usual = solve(replace(problem, rho_normal=None, rho_tangential=None))
    np.testing.assert_allclose(solution.forces, usual.forces, rtol=0, atol=1e-6 * np.abs(usual.forces).max())
    assert hard_cases.judge(solution)[0] == hard_cases.judge(restore(problem, strip(solution)))[0] == "converged"
    assert hard_cases.judge(replace(solution, problem=problem))[0] == "wrong"


def test_pairs_about_to_stick_need_no_fallback():
    """With the law's own share of their mean friction Newton creeps past them; it begins with a larger one."""
    case = hard_cases.Case("lap joint", 1 / 3, ("reached", 3.0), 1.5, 5, 0.02, "closed", (1, 1))
    solution = solve(hard_cases.pose_case(case))
    assert solution.fallbacks == () and solution.residual <= 1e-8
    balance = HarmonicBalance(solution.problem.system)
    assert balance.firm is not balance
    start = balance.pack(*balance.full_stick)
    with closing(snes._Newton(balance, "elimination", None)) as newton:
        by_itself = newton.run(balance, start, 1e-8, near=False)
    assert solution.iterations <= 20 and by_itself.iterations > 3 * solution.iterations


def test_time_stepping_finds_a_start_that_newton_does_not():
    """A whole flank lifts off far below the resonance: full stick is no start, in no set of harmonics."""
    case = hard_cases.Case("blade root", 0.3, ("reached", 1.0), 0.05, 5, 0.005, "half open", (1, 1))
    solution = solve(hard_cases.pose_case(case))
    assert [rung.split(":")[0] for rung in solution.fallbacks] == ["cold start", "time stepping"]
    assert solution.iterations <= 40


def test_a_motion_that_does_not_become_periodic_is_said_to_be_so(monkeypatch):
    """Hundreds of periods in fine steps go on changing; rounding decides whether a start from there leads anywhere."""
    case = hard_cases.Case("dovetail", 1 / 3, ("reached", 3.0), 1.5, 9, 1e-4, "half open", (1, 1))
    problem = hard_cases.pose_case(case)
    fine = time_integration.integrate(problem, steps=1600, periods=200, tolerance=1e-3)
    assert not fine.converged and np.median(fine.changes[-50:]) > newton.APERIODIC
    balance = HarmonicBalance(problem.system)
    start = newton.begin_at_full_stick(balance)
    monkeypatch.setattr(newton, "split_at_length", lambda *_: None)
    monkeypatch.setattr(newton, "follow_from_afar", lambda *_: None)
    monkeypatch.setattr(newton, "run_newton", lambda _, unknowns, *given: Attempt(unknowns, 0.1, 1, "as if", False))
    told, stepped = " (from period to period its motion still changes ", newton.step_coarsely(problem)
    for astray, reason, steps in ((np.inf, "as if", 3), (newton.ASTRAY, start.reason, 1)):  # the starts are far off
        monkeypatch.setattr(newton, "ASTRAY", astray)
        attempt = newton.start_from_time_stepping(stepped, balance, 1e-8, "elimination", start)
        assert attempt.reason.startswith(reason + told) and attempt.iterations == steps


def test_a_run_that_creeps_far_off_is_given_up():
    """It took 33 steps to creep at one residual; from the few that it takes now, the other ways take over."""
    case = hard_cases.Case("dovetail", 1.5, ("reached", 3.0), 0.05, 3, 1e-3, "even", (1, 1))
    problem = hard_cases.pose_case(case)
    balance = HarmonicBalance(problem.system)
    run = snes.run_newton(balance, balance.pack(*balance.full_stick), 1e-8, "elimination")
    assert not run.converged and run.reason == "the residual fell no further" and run.iterations <= 20
    assert run.residual > snes.CLOSER
    assert solve(problem).iterations <= 30


@pytest.mark.parametrize(
    "case",
    [
        hard_cases.Case("dovetail", 1 / 3, ("reached", 3.0), 1.5, 5, 0.05, "closed", (1, 1)),
        hard_cases.Case("lap joint", 2.0, ("reached", 3.0), 0.01, 15, 0.005, "even", (1, 1)),
    ],
    ids=lambda case: case.model,
)
def test_falling_damping_leads_where_a_cold_start_does_not(case):
    """Bodies leave each other and bounce; damping that hardly lets them falls to the model's own."""
    problem = hard_cases.pose_case(case)
    balance = HarmonicBalance(problem.system)
    lost = ladder.begin_at_full_stick(balance)
    assert not ladder.start_cold(balance, 1e-8, "elimination", ladder.COARSE_LEVELS, ladder.COARSE_TOLERANCE).converged
    found = ladder.trace_damping(balance, 1e-8, lost)
    assert found.converged and np.linalg.norm(balance.residual(found.unknowns)) <= 1e-8
    merit = newton.wrap(problem, balance, [found], (), 0.0).merit
    assert abs(merit["energy_error"]) < 1e-2  # with the model's own damping, not that which was added


@pytest.mark.parametrize("damping", [1.0, 0.0], ids=["damped", "undamped"])
def test_falling_damping_ends_at_the_solution_where_there_is_one(damping):
    """Where others lead as well, to the same; without any damping of the model's own, too."""
    case = hard_cases.Case("lap joint", 0.5, ("reached", 1.0), 0.2, 3, 0.005, "closed", (1, 1))
    problem = hard_cases.pose_case(case)
    problem = replace(problem, model=replace(problem.model, damping=damping * problem.model.damping))
    balance = HarmonicBalance(problem.system)
    found = ladder.trace_damping(balance, 1e-8, ladder.begin_at_full_stick(balance))
    usual = solve(problem)
    forces = balance.unpack(found.unknowns)[0]
    assert found.converged
    np.testing.assert_allclose(forces, usual.forces, rtol=0, atol=1e-6 * np.abs(usual.forces).max())
    rungs = [name for name, _ in newton.list_rungs(problem, balance, None, 1e-8, "elimination")]
    assert rungs.index("rounded corners") + 1 == rungs.index("falling damping") < len(rungs) - 1


def test_rounded_corners_are_begun_where_newton_stalled():
    """One pair of seven grazes, and Newton ends close to the solution at a corner, or not: a matter of rounding.

    From nearby, the corners are sharpened in fewer steps than from full stick; medians of twelve places nearby.
    """
    case = hard_cases.Case("lap joint", 1 / 3, ("applied", 0.03), 1.0, 5, 1e-4, "random", (1, 1))
    problem = hard_cases.pose_case(case)
    assert solve(problem).residual <= 1e-8
    balance = HarmonicBalance(problem.system)
    found = ladder.climb(balance, 1e-8, "elimination", ladder.COARSE_LEVELS).unknowns
    rng, steps = np.random.default_rng(1), []
    for _ in range(12):
        nearby = found + 1e-5 * rng.standard_normal(balance.size) / np.sqrt(balance.size)
        residual = float(np.linalg.norm(balance.residual(nearby)))
        stalled = Attempt(nearby, residual, 0, "stalled", converged=False)
        sharpened = [
            ladder.sharpen_corners(balance, 1e-8, replace(stalled, residual=known)) for known in (residual, np.inf)
        ]
        assert all(a.converged and a.reason.endswith("residual below the tolerance") for a in sharpened)
        np.testing.assert_allclose(sharpened[0].unknowns, sharpened[1].unknowns, atol=1e-5)
        steps.append([attempt.iterations for attempt in sharpened])
    near, from_full_stick = np.median(steps, axis=0)
    assert near < 0.8 * from_full_stick


def test_without_a_compiler_the_ladder_goes_on(monkeypatch):
    def refuse(*_, **__):
        raise ImportError("time integration needs numba")

    monkeypatch.setattr(time_integration, "integrate", refuse)
    case = hard_cases.Case("dovetail", 1 / 3, ("reached", 1.0), 0.2, 5, 0.02, "closed", (1, 1))
    solution = solve(hard_cases.pose_case(case))
    assert "time stepping: time integration needs numba" in solution.fallbacks
    assert solution.converged and len(solution.fallbacks) > 2
