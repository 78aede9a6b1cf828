"""Friction under a normal load that varies over the period: the mean friction force of a pair that slips is not zero.

``x'' + d x' + k x = P cos tau + lam``, ``|lam| <= N(tau) = N0 + N1 cos(tau + phase)``, friction coefficient 1. Where
the normal load is larger during one stroke than during the other, friction is as well, and its mean shifts the
spring: ``k X_0 = Lam_0``. ``static_friction="zero"`` (as in the paper) forbids that: it leaves the cone however many
harmonics are kept. ``"resolved"`` converges to the steady state of the time stepping below.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from small_models import friction_oscillator, lift_off_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve, solve_to_accuracy
from ewr_fenicsx.accuracy.estimates import measure_distance
from ewr_fenicsx.problem.dashpots import match_mobility
from ewr_fenicsx.solution.solution import PeriodicSolution

DAMPING, FREQUENCY, MEAN_LOAD = 0.15, 0.8, 0.4
STEPS = 4000  # a period
CASES = [(0.3, 0.9), (0.2, -2.0)]  # ripple, phase


@lru_cache
def step_to_the_steady_state(ripple: float, phase: float) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and friction force over a period, by the midpoint rule with friction on the end velocity.

    Returns:
        Both ``(STEPS,)``; the displacement at the step's begin, friction as its mean over the step.
    """
    dt = 2 * np.pi / FREQUENCY / STEPS
    tau = 2 * np.pi * (np.arange(STEPS) + 0.5) / STEPS
    loads, limits = np.cos(tau).tolist(), (MEAN_LOAD + ripple * np.cos(tau + phase)).tolist()
    x = v = 0.0
    inertia = 1.0 + 0.5 * dt * DAMPING + 0.25 * dt * dt
    displacement, friction = np.zeros(STEPS), np.zeros(STEPS)
    for _ in range(60):
        last = (x, v)
        for i in range(STEPS):
            # v1 if no friction acted; friction then takes away as much of it as it can, up to all
            free = (v * (1.0 - 0.5 * dt * DAMPING - 0.25 * dt * dt) + dt * (loads[i] - x)) / inertia
            force = min(limits[i], max(-limits[i], -free * inertia / dt))
            v1 = free + dt * force / inertia
            displacement[i], friction[i] = x, force
            x += 0.5 * dt * (v + v1)
            v = v1
        if abs(x - last[0]) + abs(v - last[1]) < 1e-12:
            return displacement, friction
    raise AssertionError("no steady state in 60 periods")


@lru_cache
def balance_harmonics(
    ripple: float, phase: float, static_friction: str, highest: int, rho: float = 0.1
) -> PeriodicSolution:
    laws = ContactLaws(
        "prescribed",
        normal_force={0: MEAN_LOAD, 1: ripple * np.exp(1j * phase)},
        friction=1.0,
        static_friction=static_friction,
    )
    model = friction_oscillator(damping=DAMPING)
    problem = ContactProblem(
        model, laws, FREQUENCY / (2 * np.pi), highest, max(256, 64 * highest), rho_tangential=rho * FREQUENCY
    )
    return solve(problem)


def displacement_error(solution: PeriodicSolution, reference: np.ndarray) -> float:
    return np.abs(solution.history("slip", STEPS)[:, 0] - reference).max() / np.ptp(reference) * 2


@pytest.mark.parametrize("ripple, phase", CASES)
def test_the_reference_is_right(ripple, phase):
    """Its own books: the spring carries the mean friction, and the friction force keeps to the cone."""
    x, friction = step_to_the_steady_state(ripple, phase)
    tau = 2 * np.pi * np.arange(STEPS) / STEPS
    assert x.mean() == pytest.approx(friction.mean(), abs=1e-6)
    assert abs(friction.mean()) > 0.05
    velocity = np.gradient(np.append(x, x[0]), 2 * np.pi / FREQUENCY / STEPS)[:-1]
    work = np.mean((np.cos(tau) - DAMPING * velocity + friction) * velocity)
    assert abs(work) < 1e-3 * np.mean(DAMPING * velocity**2)


@pytest.mark.parametrize("ripple, phase", CASES)
def test_resolved_mean_friction_converges(ripple, phase):
    x, friction = step_to_the_steady_state(ripple, phase)
    solutions = [balance_harmonics(ripple, phase, "resolved", n) for n in (5, 15, 47)]
    errors = [displacement_error(s, x) for s in solutions]
    assert errors[2] < 0.0035 and errors[2] < errors[1] / 2 < errors[0] / 4, errors
    means = [abs(s.forces[0, 0].real / friction.mean() - 1) for s in solutions]
    assert means[2] < 0.01 and means[2] < means[0] / 3, means


@pytest.mark.parametrize("ripple, phase", CASES)
def test_mean_friction_set_to_zero_stays_off(ripple, phase):
    """By the whole shift of the spring, a good tenth of the amplitude, whatever the number of harmonics."""
    x, friction = step_to_the_steady_state(ripple, phase)
    shift = abs(friction.mean()) / np.ptp(x) * 2
    for n in (15, 47):
        zero = balance_harmonics(ripple, phase, "zero", n)
        assert zero.forces[0, 0] == 0.0
        assert displacement_error(zero, x) > 0.8 * shift > 0.04
        assert displacement_error(zero, x) > 5 * displacement_error(balance_harmonics(ripple, phase, "resolved", n), x)


@pytest.mark.parametrize("ripple, phase", CASES)
def test_mean_friction_set_to_zero_leaves_the_cone(ripple, phase):
    """A third of the largest limit, hardly less with more harmonics; the resolved one's is ringing, which fades."""
    violation = lambda kind, n: balance_harmonics(ripple, phase, kind, n, rho=1.0).merit["cone_violation"]  # noqa: E731
    assert violation("zero", 15) > 0.3 and violation("zero", 47) > 0.87 * violation("zero", 15)
    assert violation("resolved", 15) < 0.12 and violation("resolved", 47) < 0.75 * violation("resolved", 15)


@pytest.mark.parametrize("static_friction", ["zero", "resolved"])
def test_weights_show_whatever_the_harmonics_where_mean_friction_is_set_to_zero(static_friction):
    """Four times the weight moves the tip by a third, with 15 harmonics as with 63: no accuracy is reached so."""
    laws = ContactLaws(friction=0.5, static_friction=static_friction)
    problem = ContactProblem(lift_off_oscillator(excitation=2.0), laws, 0.25, closure="dashpot", rho_tangential=0.5)
    for highest in (15, 63):
        posed = replace(problem, harmonics=highest)
        solution, heavier = solve(posed), solve(replace(posed, rho_tangential=2.0))
        change = measure_distance(heavier, solution)
        told = any('static_friction = "zero" leaves out a mean of' in line for line in solution.cautions)
        assert (change > 0.3 and told) if static_friction == "zero" else (change < 2e-3 and not told)
    found = solve_to_accuracy(problem, 0.05)
    assert found.reached == (static_friction == "resolved")
    assert ("weight" in solution.summary()) == (static_friction == "zero")


def test_mean_friction_that_is_zero_anyway_is_not_missed():
    """By symmetry, or where nothing slips."""
    stuck = ContactProblem(lift_off_oscillator(excitation=0.01), ContactLaws(static_friction="zero"), 0.1, 3)
    for closure in ("dashpot", "spring"):
        assert solve(replace(stuck, closure=closure)).cautions == ()
    assert not any("leaves out a mean" in line for line in balance_harmonics(0.0, 0.0, "zero", 9).cautions)


def test_under_a_constant_load_both_agree():
    """By symmetry the mean friction is zero: there the two treatments are one."""
    resolved, zero = (balance_harmonics(0.0, 0.0, kind, 9) for kind in ("resolved", "zero"))
    np.testing.assert_allclose(resolved.forces, zero.forces, atol=1e-6)


@pytest.mark.parametrize(
    "static_friction, harmonics", [("zero", 15), ("resolved", tuple(range(1, 16))), ("resolved", 15)]
)
def test_masses_do_not_slide_off_where_nothing_holds_the_mean(static_friction, harmonics):
    """Without an equation for the mean they slid one way throughout: amplitudes by a half too large, without a word."""
    ripple, phase = CASES[0]
    x, _ = step_to_the_steady_state(ripple, phase)
    laws = ContactLaws(
        "prescribed",
        normal_force={0: MEAN_LOAD, 1: ripple * np.exp(1j * phase)},
        friction=1.0,
        static_friction=static_friction,
    )
    problem = ContactProblem(friction_oscillator(damping=DAMPING), laws, FREQUENCY / (2 * np.pi), harmonics)
    solution = solve(problem)
    assert (solution.problem.system.closures == ("masses",)) == (static_friction == "resolved" and harmonics == 15)
    first = 2 * abs(np.mean(x * np.exp(-2j * np.pi * np.arange(STEPS) / STEPS)))
    assert abs(solution.output("tip")[solution.orders.index(1)]) == pytest.approx(first, rel=0.05)
    assert solution.merit["J_T"] < 1.01 * 2 * np.ptp(solution.history("slip"))
    told = [line for line in solution.cautions if "at harmonic 0, which is not kept" in line]
    assert bool(told) == isinstance(harmonics, tuple)


def test_masses_close_odd_harmonics_by_themselves_where_halves_repeat():
    """Its mean friction is zero by symmetry; under a limit that differs from half to half it is not."""
    model = friction_oscillator(damping=DAMPING)
    for ripple, closures in (({0: MEAN_LOAD, 2: 0.1}, ("masses",)), ({0: MEAN_LOAD, 1: 0.1}, ())):
        laws = ContactLaws("prescribed", normal_force=ripple, friction=1.0)
        odd = ContactProblem(model, laws, FREQUENCY / (2 * np.pi), (1, 3, 5, 7))
        assert odd.system.closures == closures
        if closures:
            all_of_them = solve(replace(odd, harmonics=7))
            assert solve(odd).output("tip")[0] == pytest.approx(all_of_them.output("tip")[1], rel=1e-6)


def shaken_down(closure: str = "dashpot") -> tuple[ContactProblem, float]:
    """A spring ``k`` from a driven mass to a slider that sticks, but only where it has shifted.

    While it sticks, friction is ``m - 0.7 cos tau`` under ``N = 1 + 0.8 cos tau``: within the limits throughout where
    ``-0.9 <= m <= -0.5`` or ``0.5 <= m <= 0.9``, and not without a mean.

    Returns:
        The problem, and the amplitude of the mass.
    """
    k, support, mass, damping = 2.0, 1.0, 0.25, 0.05
    amplitude = 0.7 / k
    model = ReducedModel(
        mass=np.diag([mass, 0.0]),
        damping=np.diag([damping, 0.02]),
        stiffness=[[support + k, -k], [-k, k]],
        tangential=[[0.0, 1.0]],
        load={1: [(support + k - mass + 1j * damping) * amplitude, 0.0]},
        outputs={"mass": [1.0, 0.0]},
    )
    laws = ContactLaws("prescribed", normal_force={0: 1.0, 1: 0.8}, friction=1.0)
    return ContactProblem(model, laws, 1 / (2 * np.pi), 5, closure=closure), amplitude


@pytest.mark.parametrize("closure", ["dashpot", "spring"])
@pytest.mark.parametrize("highest", [5, 31, 63])
def test_a_pair_that_sticks_once_it_has_shifted_takes_nothing(closure, highest):
    """With the default weights and with those of an accuracy, which grow with the harmonics."""
    problem, amplitude = shaken_down(closure)
    posed = replace(problem, harmonics=highest)
    for weight in (None, match_mobility(posed)) if closure == "dashpot" else (None,):
        solution = solve(replace(posed, rho_tangential=weight))
        assert solution.output("mass")[1] == pytest.approx(amplitude, rel=1e-4)
        assert 0.499 < abs(solution.pair_forces["tangential"][0, 0].real) < 0.9
        assert solution.merit["friction_dissipation"] < 1e-4 and solution.merit["J_T"] < 1e-4 * 4 * amplitude


def test_a_pair_that_sticks_once_it_has_shifted_needs_few_harmonics():
    problem, amplitude = shaken_down()
    found = solve_to_accuracy(problem, 1e-4)
    assert found.reached and found.solution.orders[-1] <= 5
    assert abs(found.solution.output("mass")[1] / amplitude - 1) < 1e-5
