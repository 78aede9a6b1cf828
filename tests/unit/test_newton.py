"""Newton's method through PETSc: the same steps in any units, its options, its failures."""

from __future__ import annotations

import gc
from dataclasses import replace

import numpy as np
import pytest
from changed_units import change_units
from checked_solutions import measure_residual
from petsc4py import PETSc
from small_models import (
    PROBLEMS,
    dovetail,
    friction_oscillator,
    lift_off_oscillator,
    random_structure,
    repeat_first_pair,
)

from ewr_fenicsx import ContactLaws, ContactProblem, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.errors import ModelError, NotConverged, UnheldBody
from ewr_fenicsx.scene.scene import Solver
from ewr_fenicsx.solution.remedies import estimate_rounding
from ewr_fenicsx.solver import ladder, newton, snes
from ewr_fenicsx.solver.snes import run_newton


@pytest.fixture
def petsc_options():
    """Options under the package's prefix, gone after the test."""
    options, touched = PETSc.Options("ewr_"), {}

    def put(**values) -> None:
        for name, value in values.items():
            touched.setdefault(name, options.getString(name) if options.hasName(name) else None)
            options[name] = value

    yield put
    for name, value in touched.items():
        options.delValue(name)
        if value is not None:
            options[name] = value


@pytest.mark.parametrize("name", PROBLEMS)
def test_petsc_may_solve_the_linear_systems_its_own_way(name, petsc_options):
    plain = solve(PROBLEMS[name], tolerance=1e-10)
    petsc_options(pc_type="lu")
    lu = solve(PROBLEMS[name], tolerance=1e-10)
    petsc_options(pc_type="none", ksp_type="gmres", ksp_rtol=1e-13, ksp_gmres_restart=200, ksp_max_it=2000)
    krylov = solve(PROBLEMS[name], tolerance=1e-10)
    for other in (lu, krylov):
        assert other.iterations == plain.iterations
        np.testing.assert_allclose(other.forces, plain.forces, atol=1e-7 * np.abs(plain.forces).max())


def test_solutions_meet_the_tolerance_asked_for():
    for tolerance in (1e-6, 1e-8, 1e-12):
        solution = solve(PROBLEMS["floating, slip"], tolerance=tolerance)
        found = measure_residual(solution)
        assert (
            solution.converged and found <= tolerance and solution.residual == pytest.approx(found, rel=1e-3, abs=1e-15)
        )


def test_the_number_of_steps_is_petscs_to_limit(petsc_options):
    """Of each Newton run: too few send the solver to its fallbacks, or leave it without a solution."""
    problem = PROBLEMS["floating, slip"]
    assert (plain := solve(problem)).iterations > 3 and plain.fallbacks == ()
    petsc_options(snes_max_it=2)
    limited = solve(problem, raise_on_failure=False)
    assert limited.fallbacks or not limited.converged
    petsc_options(snes_max_it=1)  # also of runs that the package limits itself
    balance = HarmonicBalance(problem.system)
    assert run_newton(balance, balance.pack(*balance.full_stick), 1e-9, "elimination", limit=40).iterations == 1


def test_where_the_firm_balance_takes_all_steps_allowed_the_balance_is_not_tried(monkeypatch):
    """However near the start: from there it would have taken as many, 31 of 33 times."""
    problem = PROBLEMS["floating, slip"]
    balance, found = HarmonicBalance(problem.system), solve(problem)
    start = 1.0001 * balance.pack(found.forces, found.rigid)
    assert 1e-5 < np.linalg.norm(balance.residual(start)) < 3e-3
    tried, run = [], snes._Newton.run
    monkeypatch.setattr(
        snes._Newton, "run", lambda self, *given, **more: tried.append(given) or run(self, *given, **more)
    )
    attempt = run_newton(balance, start, 1e-8, "elimination", limit=1)
    assert [given[0] for given in tried] == [balance.firm] and not attempt.converged
    assert attempt.residual == np.linalg.norm(balance.residual(attempt.unknowns))


def test_convergence_is_the_residual_at_the_end_and_nothing_else():
    balance = HarmonicBalance(PROBLEMS["floating, slip"].system)
    start = balance.pack(*balance.full_stick)
    residual = np.linalg.norm(balance.residual(start))
    for tolerance, converged in ((residual * 1.01, True), (residual * 0.99, False)):
        attempt = run_newton(balance, start, tolerance, "elimination", 0)
        assert attempt.converged == converged and attempt.residual == pytest.approx(residual, rel=1e-12)
        np.testing.assert_array_equal(attempt.unknowns, start)


def test_monitors_work_under_the_prefix(petsc_options, capfd):
    petsc_options(snes_monitor="")
    solve(PROBLEMS["lift-off"])
    printed = capfd.readouterr().out
    assert "SNES Function norm" in printed


@pytest.mark.parametrize("tolerance", [0.0, 1e-17, 0.5, np.nan])
def test_tolerances_that_mean_nothing_are_refused(tolerance):
    with pytest.raises(ModelError, match=f"tolerance = {tolerance}; give one from 1e-13, .*, to 0.001"):
        solve(PROBLEMS["floating, slip"], tolerance=tolerance)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"start": np.zeros(8)}, r"start = array\(.*; give a solution that solve returned, or None"),
        ({"problem": dovetail()}, r"problem = ReducedModel\(.*; give ContactProblem\(model, laws, frequency\)"),
        ({"linear_solver": "lu"}, "linear_solver = 'lu'; choose one of elimination, dense"),
        ({"linear_solver": "elimnation"}, 'did you mean "elimination"'),
        ({"tolerance": "tight"}, "tolerance = 'tight'; give one from 1e-13"),
        ({"tolerance": None}, "tolerance = None; give one from 1e-13"),
    ],
)
def test_arguments_that_are_none_of_their_kind_are_refused(arguments, message):
    with pytest.raises(ModelError, match=message):
        solve(**{"problem": PROBLEMS["floating, slip"]} | arguments)


def test_a_start_that_is_no_number_is_refused():
    found = solve(PROBLEMS["floating, slip"])
    with pytest.raises(ModelError, match="start has forces that are not finite; give a solution that converged"):
        solve(found.problem, replace(found, forces=np.nan * found.forces))


def test_the_bounds_of_the_tolerance_are_those_of_a_scene():
    bounds = {type(m).__name__: m for m in Solver.model_fields["tolerance"].metadata}
    assert (bounds["Ge"].ge, bounds["Le"].le) == (newton.TIGHTEST, newton.LOOSEST)


@pytest.fixture
def unreachable(monkeypatch) -> float:
    """A tolerance that rounding does not let any solve meet."""
    monkeypatch.setattr(newton, "TIGHTEST", 0.0)
    return 1e-300


def test_failure_is_an_error_that_carries_the_best_iterate(unreachable, caplog):
    """A tolerance below rounding cannot be met: what was found up to there comes with the error, and is logged."""
    caplog.set_level("INFO", "ewr_fenicsx")
    problem = PROBLEMS["floating, slip"]
    with pytest.raises(
        NotConverged, match=r"no periodic solution at 481 Hz: .*; residual .* after \d+ Newton steps.*Try fewer "
    ) as caught:
        solve(problem, tolerance=unreachable)
    best = caught.value.best
    names = [rung.split(":")[0] for rung in best.fallbacks]
    assert caplog.messages == [
        f"481 Hz: {rung}; next: {following}" for rung, following in zip(best.fallbacks, names[1:], strict=False)
    ]
    assert caught.value.exit_code == 3
    assert not best.converged and 0 < best.residual < 1e-10
    assert best.forces.shape == (6, 12) and best.history("gap", 16).shape == (16, 6)
    found = measure_residual(best)
    assert best.residual == pytest.approx(found, rel=1e-6, abs=1e-15)


def test_a_failure_may_be_returned_as_it_would_be_raised(unreachable):
    problem, asked = PROBLEMS["floating, slip"], {"tolerance": unreachable, "fallbacks": False}
    with pytest.raises(NotConverged) as caught:
        solve(problem, **asked)
    returned = solve(problem, **asked, raise_on_failure=False)
    assert not returned.converged
    np.testing.assert_array_equal(returned.forces, caught.value.best.forces)


def test_weights_of_ones_own_fail_where_the_default_ones_do(unreachable):
    """Those take every rung there is: no rung is climbed twice."""
    with pytest.raises(NotConverged, match=r"not solved with the default weights: .* Try fewer") as caught:
        solve(replace(PROBLEMS["floating, slip"], rho_normal=1e9), tolerance=unreachable)
    rungs = caught.value.best.fallbacks
    assert [rung.split(":")[0] for rung in rungs] == ["cold start", "from the default weights and dashpots"]
    for tried in ("with these: cold start:", "time stepping:", "more sets of harmonics:"):
        assert tried in rungs[1], "what was tried with the default weights is listed as well"


def test_a_climb_that_fails_tells_how_far_it_came(unreachable, monkeypatch):
    monkeypatch.setattr(ladder, "can_split", lambda _: False)
    posed = replace(PROBLEMS["floating, slip"], harmonics=15)
    lost = solve(posed, tolerance=unreachable, fallbacks=False, raise_on_failure=False)
    assert lost.reason.endswith("; harmonics up to 5 were solved for")
    alone = solve(replace(posed, harmonics=5), tolerance=unreachable, fallbacks=False, raise_on_failure=False)
    assert not alone.converged and "solved for" not in alone.reason


def test_a_failure_by_rounding_far_below_the_modes_of_a_floating_body_says_so():
    """The motion that rounded forces cause grows as the frequency falls; with what they leave allowed, it is solved."""
    problem = replace(PROBLEMS["floating, slip"], frequency=1e-3)
    with pytest.raises(NotConverged, match=r"rounding alone leaves .* larger tolerance$") as caught:
        solve(problem)
    assert 1e-8 < caught.value.best.residual < 10 * estimate_rounding(problem)
    static = np.abs(solve(replace(problem, frequency=1.0)).output("tip"))
    np.testing.assert_allclose(np.abs(solve(problem, tolerance=1e-5).output("tip"))[1], static[1], rtol=1e-4)


def test_the_best_iterate_is_the_best_of_all_attempts(petsc_options, unreachable):
    """A start next to the solution is kept, though the attempts after it, from full stick, get nowhere."""
    problem = PROBLEMS["floating, slip"]
    near = solve(problem, tolerance=1e-6)
    petsc_options(snes_max_it=0)
    lost = solve(problem, start=near, tolerance=unreachable, raise_on_failure=False)
    assert not lost.converged and lost.residual < 1e-6


def test_an_attempt_that_ends_in_no_number_is_never_the_best():
    lost, found = (snes.Attempt(np.zeros(1), residual, 1, "", False) for residual in (np.nan, 1e-3))
    assert min(lost, found) is min(found, lost) is found


@pytest.mark.parametrize(
    "model",
    [dovetail(pull=0.0, excitation=0.0), lift_off_oscillator(preload=0.0, excitation=0.0)],
    ids=["dovetail", "lift-off"],
)
def test_no_load_no_force(model):
    solution = solve(ContactProblem(model, ContactLaws(), 100.0, 3))
    assert solution.converged and np.all(solution.forces == 0.0) and np.all(solution.history("slip", 16) == 0.0)
    assert all(np.isfinite(value) for value in solution.merit.values())


def test_a_linear_problem_needs_no_newton():
    for laws in (ContactLaws("bonded", "bonded"), ContactLaws("bonded", "frictionless")):
        solution = solve(ContactProblem(lift_off_oscillator(), laws, 0.1, 3))
        assert (solution.converged, solution.iterations, solution.unknowns, solution.residual) == (True, 0, 0, 0.0)


def test_a_stuck_joint_takes_one_step_at_most():
    assert solve(PROBLEMS["stuck"]).iterations <= 1


@pytest.mark.parametrize("friction", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("excitation", [1.6, 4.0])
@pytest.mark.parametrize("frequency", [0.1, 0.16, 0.2, 0.25])
def test_lift_off_without_contact_mass_is_no_hard_case(frequency, excitation, friction):
    """From stick to landing at every period, below and above resonance, cold."""
    model = lift_off_oscillator(excitation=excitation)
    for harmonics in (5, 15):
        solution = solve(ContactProblem(model, ContactLaws(friction=friction), frequency, harmonics))
        assert solution.residual <= 1e-8 and abs(solution.merit["energy_error"]) < 2e-4


@pytest.mark.parametrize("friction", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("ratio", [0.8, 1.0, 1.2])
def test_a_floating_joint_through_its_resonance(ratio, friction):
    """400.9 Hz is its first full-stick mode; two hundred newtons slide and open flanks."""
    solution = solve(ContactProblem(dovetail(excitation=200.0), ContactLaws(friction=friction), ratio * 400.9, 5))
    assert solution.residual <= 1e-8
    applied = solution.problem.model.normal.T @ solution.pair_forces["normal"][0].real
    applied = applied + solution.problem.model.tangential.T @ solution.pair_forces["tangential"][0].real
    np.testing.assert_allclose([applied[0:14:2].sum(), applied[1:14:2].sum()], [0.0, -1000.0], atol=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_a_blade_that_is_pushed_out_of_its_flanks_is_unheld(seed):
    """Whatever basis of its rigid motions was found, which is a matter of rounding."""
    model, mix = dovetail(pull=-1000.0), np.random.default_rng(seed).normal(size=(3, 3))
    model = replace(model, rigid_modes=model.rigid_modes @ mix)
    with pytest.raises(
        UnheldBody, match=r"nothing holds a floating body: 100% of the mean load .* opens pairs \d, \d, \d most"
    ):
        solve(ContactProblem(model, ContactLaws(), 200.0, 3))


# Limits in which one law becomes another


def agree(first, second, tolerance: float) -> None:
    scale = np.abs(second.output("tip")).max()
    np.testing.assert_allclose(first.output("tip"), second.output("tip"), atol=tolerance * scale)
    forces = np.abs(second.pair_forces["normal"]).max()
    np.testing.assert_allclose(first.pair_forces["normal"], second.pair_forces["normal"], atol=tolerance * forces)


@pytest.mark.parametrize(
    "problem",
    [PROBLEMS["lift-off"], ContactProblem(dovetail(excitation=1.0), ContactLaws(), 200.0, 3)],
    ids=["lift-off", "dovetail"],
)
def test_no_friction_is_frictionless(problem):
    zero = solve(replace(problem, laws=ContactLaws(friction=0.0)), tolerance=1e-11)
    none = solve(replace(problem, laws=ContactLaws(tangential="frictionless")), tolerance=1e-11)
    assert none.unknowns < zero.unknowns
    agree(zero, none, 1e-8)


def test_a_gap_that_never_closes_leaves_the_structure_free():
    model = random_structure()
    model = replace(model, load={0: np.ones(9), 1: np.arange(9.0)})
    free = solve(ContactProblem(model, ContactLaws("prescribed", "frictionless", normal_force=0.0), 0.1, 3))
    apart = solve(ContactProblem(model, ContactLaws(initial_gap=1e3), 0.1, 3), tolerance=1e-11)
    assert apart.merit["J_N"] > 900 and np.abs(apart.forces).max() < 1e-6
    np.testing.assert_allclose(apart.output("tip"), free.output("tip"), atol=1e-7 * np.abs(free.output("tip")).max())


def test_multiples_of_the_frequency_are_a_matter_of_counting():
    """A load at harmonic 2 of f is one at harmonic 1 of 2f."""
    model = lift_off_oscillator(excitation=4.0)
    counted = replace(model, load={0: model.load[0], 2: model.load[1]})
    laws = ContactLaws(friction=0.3)
    plain = solve(ContactProblem(model, laws, 0.2, 4, 128, rho_tangential=0.5), tolerance=1e-11)
    other = solve(ContactProblem(counted, laws, 0.1, (0, 2, 4, 6, 8), 256, rho_tangential=0.5), tolerance=1e-11)
    np.testing.assert_allclose(other.forces, plain.forces, atol=1e-8 * np.abs(plain.forces).max())
    assert other.merit["excitation_work"] == pytest.approx(2 * plain.merit["excitation_work"], rel=1e-8)


@pytest.mark.parametrize("name", ["floating, slip", "floating, mean zero", "lift-off", "stuck", "prescribed"])
def test_units_change_no_step(name):
    """1 m = 1000 mm, 1 kg = 1e-3 t; N and s stay."""
    problem = PROBLEMS[name]
    if name == "lift-off":
        problem = replace(problem, laws=replace(problem.laws, initial_gap=0.02))
    other = change_units(problem, length=1e3, mass=1e-3, time=1.0)
    metres, millimetres = solve(problem, tolerance=1e-10), solve(other, tolerance=1e-10)
    assert metres.iterations == millimetres.iterations
    rounding = 1e-12  # two orders below the tolerance
    assert metres.residual == pytest.approx(millimetres.residual, rel=1e-2, abs=rounding)
    np.testing.assert_allclose(millimetres.forces, metres.forces, atol=1e-9 * np.abs(metres.forces).max())
    np.testing.assert_allclose(
        millimetres.rigid, 1e3 * metres.rigid, atol=1e-6 * np.abs(millimetres.rigid).max(initial=0.0)
    )
    for output in metres.problem.model.outputs:
        np.testing.assert_allclose(millimetres.output(output), 1e3 * metres.output(output), rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(millimetres.history("gap", 32), 1e3 * metres.history("gap", 32), atol=1e-6)


def test_redundant_pairs_share_their_force():
    """The same pair twice: neither the motion nor the force in all changes."""
    model = lift_off_oscillator(excitation=4.0)
    laws = ContactLaws(friction=0.3)
    one, two = (solve(ContactProblem(m, laws, 0.2, 5), tolerance=1e-10) for m in (model, repeat_first_pair(model)))
    np.testing.assert_allclose(two.output("tip"), one.output("tip"), atol=1e-3 * np.abs(one.output("tip")).max())
    np.testing.assert_allclose(
        two.pair_forces["normal"].sum(axis=1)[0], one.pair_forces["normal"].sum(axis=1)[0], rtol=1e-3
    )


def test_a_static_problem_has_one_harmonic():
    """Frequency zero, harmonic zero: three pairs pressed unequally, one of them pulled open."""
    model = random_structure()
    load = 5.0 * model.normal.T @ np.linalg.solve(model.normal @ model.normal.T, [-1.0, -2.0, 3.0])
    solution = solve(
        ContactProblem(replace(model, load={0: load}), ContactLaws(tangential="frictionless"), 0.0, 0), tolerance=1e-12
    )
    gap, force = solution.history("gap", 1)[0], solution.history("normal_force", 1)[0]
    assert np.all(gap > -1e-10) and np.all(force > -1e-10) and np.abs(gap * force).max() < 1e-9
    assert np.any(gap > 1e-3) and np.any(force > 1e-3)
    np.testing.assert_allclose(
        model.stiffness @ solution.coordinates[0].real, load + model.normal.T @ force, atol=1e-10
    )


def test_without_a_mass_the_rubbing_spring_is_quasi_static():
    """The play operator: the spring lags behind the load by what friction carries, and stops at its turn."""
    laws = ContactLaws("prescribed", normal_force=1.0, friction=0.3)
    solution = solve(ContactProblem(friction_oscillator(mass=0.0), laws, 0.01, 31))
    load = np.cos(2 * np.pi * np.arange(512) / 512)
    motion, x = np.zeros(512), 0.0
    for k in range(1024):
        x = np.clip(x, load[k % 512] - 0.3, load[k % 512] + 0.3)
        motion[k % 512] = x
    np.testing.assert_allclose(solution.history("slip", 512)[:, 0], motion, atol=0.01)


@pytest.mark.parametrize("linear_solver", ["elimination", "dense"])
def test_nothing_of_a_solve_stays_in_memory(linear_solver):
    """PETSc's objects and Python's hold each other: dense factors of every solve stayed, gigabytes in a long sweep."""
    gc.collect()
    before = count_equations()
    solve(ContactProblem(dovetail(excitation=60.0), ContactLaws(friction=0.3), 300.0, 3), linear_solver=linear_solver)
    gc.collect()
    assert count_equations() <= before


def count_equations() -> int:
    return sum(isinstance(thing, snes._Equations) for thing in gc.get_objects())


def test_petsc_keeps_nothing_of_a_solve(capfd):
    """What Python merely lets go of, PETSc keeps until it ends: three vectors a run of Newton's method, for ever."""
    PETSc.garbage_cleanup(PETSc.COMM_SELF)
    PETSc.garbage_view(PETSc.COMM_SELF)
    before = capfd.readouterr().out
    solve(PROBLEMS["floating, slip"])
    PETSc.garbage_view(PETSc.COMM_SELF)
    assert capfd.readouterr().out == before
