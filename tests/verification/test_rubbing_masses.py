"""Floquet multipliers of masses that rub and turn: deviations of their velocity jump there, which is a closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.in_time import floquet
from ewr_fenicsx.in_time.deviations import differentiate_laws


def rub(damping: float, friction: float, frequency: float, harmonics: int, light: float | None = None):
    """Solution of a mass on a spring that rubs under a given force, and its multipliers; or of a light one beside it.

    Deviations are those of free masses but where the one that rubs turns: there its velocity's jumps by the ratio of
    the accelerations after and before.
    """
    mass, rows = (np.eye(1), [[1.0]]) if light is None else (np.diag([1.0, light]), [[0.0, 1.0]])
    stiffness = np.eye(1) if light is None else np.array([[1.5, -0.5], [-0.5, 0.501]])
    n = len(mass)
    first, damped = np.eye(n)[0], damping * np.diag(np.eye(n)[0])
    model = ReducedModel(mass, damped, stiffness, tangential=rows, load={1: first}, outputs={"tip": first})
    laws = ContactLaws("prescribed", normal_force=friction, friction=1.0)
    found = solve(ContactProblem(model, laws, frequency, harmonics))
    omega, orders, times = found.problem.omega, np.array(found.orders), np.linspace(0, 1 / frequency, 20001)
    phases = np.exp(1j * omega * np.outer(times, orders))
    moved, speed = (np.real(phases @ (rate * found.coordinates)) for rate in (1.0, 1j * omega * orders[:, None]))
    push = np.cos(omega * times) * first[-1] - moved @ stiffness[-1] - speed @ damped[-1]
    state = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damped)]]
    )
    whole, before = np.eye(2 * n), 0.0
    turns = np.flatnonzero(np.diff(np.sign(speed[:, -1])))
    for at in turns:
        assert abs(push[at]) > friction, "it turns and does not stick"
        whole = expm(state * (times[at] - before)) @ whole
        whole[-1] *= (abs(push[at]) - friction) / (abs(push[at]) + friction)
        before = times[at]
    return found, np.linalg.eigvals(expm(state * (times[-1] - before)) @ whole)


@pytest.mark.parametrize("harmonics", [5, 15])
@pytest.mark.parametrize("strength", [0.1, 0.05, 0.02])
@pytest.mark.parametrize("frequency", [0.08, 0.1, 0.12, 0.14, 0.18, 0.2, 0.25])
def test_a_rubbing_mass_leaves_where_the_closed_form_says(frequency, strength, harmonics):
    found, multipliers = rub(-strength, strength, frequency, harmonics)
    exact = max(abs(multipliers))
    if abs(exact - floquet.GROWTH) > 0.005:
        assert found.unstable and abs(found.multiplier) == pytest.approx(exact, rel=0.06)
    damped, multipliers = rub(strength, strength, frequency, harmonics)
    assert max(abs(multipliers)) < 1 and damped.multiplier == 0 and not damped.unstable


@pytest.mark.parametrize("harmonics", [9, 15, 31, 63])
@pytest.mark.parametrize(
    ("frequency", "light", "damping"), [(0.13, 0.5, -0.1), (0.25, 0.5, -0.1), (0.25, 0.5, 0.1), (0.17, 0.1, -0.03)]
)
def test_a_mass_beside_one_that_rubs_leaves_where_the_closed_form_says(frequency, light, damping, harmonics):
    found, multipliers = rub(damping, 0.1, frequency, harmonics, light)
    exact = max(abs(multipliers))
    assert (exact > floquet.GROWTH) == (damping < 0) == found.unstable
    assert abs(found.multiplier) == pytest.approx(exact if damping < 0 else 0.0, rel=0.03)


@pytest.mark.parametrize("friction", [0.1, 0.2, 0.3])
def test_friction_holds_back_what_damping_feeds_a_little(friction):
    """Free, the mass would leave by 1.05 a period."""
    found, multipliers = rub(-0.01, friction, 0.1, 15)
    assert max(abs(multipliers)) < 0.95 and found.multiplier == 0 and not found.unstable


def test_rows_slide_on_through_short_sticking_only():
    found, _ = rub(-0.1, 0.1, 0.1, 15)
    slopes = differentiate_laws(replace(found, problem=replace(found.problem, closure="dashpot")), 512)
    assert [d.variable for d in slopes.derivatives] == ["force", "velocity"]
    assert 4 < np.count_nonzero(slopes.derivatives[0].values == 0) < 34
    sliding = slopes.slide_through_turns(17)
    assert np.all(sliding.derivatives[0].values == 1) and np.all(sliding.derivatives[1].values == 0)
    assert slopes.slide_through_turns(1) is slopes
