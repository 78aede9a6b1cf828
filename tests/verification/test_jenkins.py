"""A slider behind a spring (Jenkins element), driven slowly: micro-slip's building block, with closed forms.

One end of the spring ``k`` follows ``X cos tau``, driven through a stiff support; the other end rubs with the limit
``F = mu N``. For ``X > F/k`` a cycle costs ``4 F (X - F/k)``, and the first harmonic of the spring's force is that
of the equivalent stiffness ``(k/pi) (theta - sin(2 theta)/2)``, ``theta = arccos(1 - 2F/(k X))``. The slider's stops
and starts are jumps of its velocity, and friction between them follows the spring.

Source: Gaul and Nitsche (2001), "The role of friction in mechanical joints", Appl. Mech. Rev. 54(2).
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.wear.archard import measure_wear_rate

SPRING, LIMIT, SUPPORT = 2.0, 0.6, 1e7
AMPLITUDES = (0.32, 0.45, 0.75, 1.5)  # slip begins at F/k = 0.3


@lru_cache
def drive(amplitude: float, highest: int) -> PeriodicSolution:
    """Slow motion under a given normal force; coordinates: the driven end, the slider."""
    model = ReducedModel(
        mass=1e-3 * np.eye(2),
        damping=np.zeros((2, 2)),
        stiffness=[[SUPPORT + SPRING, -SPRING], [-SPRING, SPRING]],
        tangential=[[0.0, 1.0]],
        load={1: [SUPPORT * amplitude, 0.0]},
        outputs={"driven": [1.0, 0.0], "stretch": [1.0, -1.0]},
    )
    laws = ContactLaws("prescribed", normal_force=LIMIT, friction=1.0)
    return solve(ContactProblem(model, laws, 1e-4, tuple(range(1, highest + 1, 2)), max(256, 64 * highest)))


@lru_cache
def drive_pressed(amplitude: float, highest: int) -> PeriodicSolution:
    """The same with a contact that could open, pressed by a dead weight of twice the limit; friction 1/2."""
    model = ReducedModel(
        mass=1e-3 * np.eye(3),
        damping=np.zeros((3, 3)),
        stiffness=[[SUPPORT + SPRING, -SPRING, 0.0], [-SPRING, SPRING, 0.0], [0.0, 0.0, 1.0]],
        normal=[[0.0, 0.0, 1.0]],
        tangential=[[0.0, 1.0, 0.0]],
        load={0: [0.0, 0.0, -2 * LIMIT], 1: [SUPPORT * amplitude, 0.0, 0.0]},
        outputs={"driven": [1.0, 0.0, 0.0], "stretch": [1.0, -1.0, 0.0]},
    )
    return solve(ContactProblem(model, ContactLaws(friction=0.5), 1e-4, highest, max(256, 64 * highest)))


def exact_work(amplitude: float) -> float:
    return 4 * LIMIT * (amplitude - LIMIT / SPRING)


def exact_stiffness(amplitude: float) -> float:
    theta = np.arccos(1 - 2 * LIMIT / (SPRING * amplitude))
    return SPRING / np.pi * (theta - np.sin(2 * theta) / 2)


def exact_force(amplitude: float, tau: np.ndarray) -> np.ndarray:
    """Masing's hysteresis loop: from the turning point at tau = 0 the spring unloads by 2 F, then the slider slips."""
    half = lambda t: np.maximum(-LIMIT, LIMIT - SPRING * amplitude * (1 - np.cos(t)))  # noqa: E731
    tau = tau % (2 * np.pi)
    return np.where(tau < np.pi, half(tau), -half(tau - np.pi))


def errors(amplitude: float, highest: int) -> tuple[float, float, float]:
    """Relative errors of the work a cycle and of the equivalent stiffness, and the largest one of the force."""
    solution = drive(amplitude, highest)
    assert abs(solution.output("driven")[0] / amplitude - 1) < 1e-6
    stiffness = np.real(SPRING * solution.output("stretch")[0] / solution.output("driven")[0])
    tau = 2 * np.pi * np.arange(512) / 512
    force = -solution.history("admissible_friction_force", 512)[:, 0]
    return (
        abs(solution.merit["friction_dissipation"] / exact_work(amplitude) - 1),
        abs(stiffness / exact_stiffness(amplitude) - 1),
        np.abs(force - exact_force(amplitude, tau)).max() / LIMIT,
    )


@pytest.mark.parametrize("amplitude", AMPLITUDES)
def test_closed_forms_agree_with_the_loop(amplitude):
    """Of the test itself: work and stiffness are those of the loop drawn here."""
    tau = 2 * np.pi * np.arange(200000) / 200000
    force, rate = exact_force(amplitude, tau), -amplitude * np.sin(tau)
    assert 2 * np.pi * np.mean(force * rate) == pytest.approx(exact_work(amplitude), rel=1e-6)
    assert 2 * np.mean(force * np.cos(tau)) / amplitude == pytest.approx(exact_stiffness(amplitude), rel=1e-6)


@pytest.mark.parametrize(
    "amplitude, work, stiffness",
    [(0.32, 0.013, 3e-4), (0.45, 0.0093, 0.0025), (0.75, 0.0050, 0.0046), (1.5, 0.0043, 0.0117)],
)
def test_work_and_stiffness_converge(amplitude, work, stiffness):
    """The loop's force converges like 1/N at its corners; work and stiffness are averages, and better."""
    few, some, many = (errors(amplitude, n) for n in (5, 15, 45))
    assert many[0] < work and many[1] < stiffness
    assert many[2] < 0.6 * some[2] < 0.36 * few[2], (few, some, many)
    assert many[2] < 0.13


@pytest.mark.parametrize("amplitude", AMPLITUDES)
def test_a_contact_that_could_open_is_the_same_while_it_is_pressed(amplitude):
    given, pressed = drive(amplitude, 9), drive_pressed(amplitude, 9)
    np.testing.assert_allclose(pressed.pair_forces["tangential"][1::2], given.pair_forces["tangential"], atol=1e-6)
    np.testing.assert_allclose(pressed.pair_forces["normal"], 2 * LIMIT * np.eye(10)[:, :1], atol=1e-8)
    assert np.abs(pressed.pair_forces["tangential"][0::2]).max() < 1e-6


@pytest.mark.parametrize("amplitude", AMPLITUDES)
def test_springs_that_close_the_truncation_need_one_harmonic(amplitude):
    """What lies behind the slider is a spring at every harmonic, so that leaving harmonics out costs nothing."""
    problem = replace(drive(amplitude, 1).problem, samples=1024, closure="spring")
    solution = solve(replace(problem, model=replace(problem.model, pair_area=[1.0])))
    assert solution.orders == (1,)
    stiffness = np.real(SPRING * solution.output("stretch")[0] / solution.output("driven")[0])
    assert stiffness == pytest.approx(exact_stiffness(amplitude), rel=1e-5)
    assert solution.merit["friction_dissipation"] == pytest.approx(exact_work(amplitude), rel=2e-5)
    force = -solution.history("admissible_friction_force", 1024)[:, 0]
    np.testing.assert_allclose(force, exact_force(amplitude, 2 * np.pi * np.arange(1024) / 1024), atol=1e-6 * LIMIT)
    slid = 4 * (amplitude - LIMIT / SPRING)  # what slides is the spring's end, not the truncated slip
    assert solution.merit["J_T"] == pytest.approx(slid, rel=2e-5)
    assert measure_wear_rate(solution, 1e-3) == pytest.approx(1e-3 * LIMIT * slid, rel=2e-5)
    worse = solve(replace(problem, closure="dashpot"))
    assert abs(worse.merit["friction_dissipation"] / exact_work(amplitude) - 1) > 0.01


def test_below_the_limit_it_is_a_spring():
    solution = drive(0.29, 9)
    assert solution.merit["friction_dissipation"] < 1e-10
    np.testing.assert_allclose(solution.output("stretch")[0], 0.29, rtol=1e-5)
    np.testing.assert_allclose(solution.output("stretch")[1:], 0.0, atol=1e-9)
