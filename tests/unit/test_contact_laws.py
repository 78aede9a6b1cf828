"""The laws at samples in time: each branch, each derivative, and the sets that their zeros describe."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.laws.bonded import Bond
from ewr_fenicsx.laws.cone import project_on_cone
from ewr_fenicsx.laws.coulomb import Coulomb
from ewr_fenicsx.laws.law_kinds import Motion
from ewr_fenicsx.laws.unilateral import Signorini

finite = st.floats(-1e3, 1e3, allow_nan=False)
positive = st.floats(1e-3, 1e3)
PAIR = np.array([0])


def at(**values: float) -> Motion:
    """What a law sees of one pair at one sample."""
    signals = {name: np.array([[float(value)]]) for name, value in values.items()}
    pick = lambda names: {d: signals[name] for d, name in names.items() if name in signals}  # noqa: E731
    return Motion(
        force=pick({"normal": "pressed", "tangential": "rub"}),
        displacement=pick({"normal": "opening", "tangential": "slip"}),
        velocity=pick({"normal": "opening_rate", "tangential": "velocity"}),
    )


def derivatives(response) -> dict[tuple[str, str], float]:
    found = {(p.variable, p.direction): float(p.values[0, 0]) for p in response.partials}
    return {key: value for key, value in found.items() if value != 0.0}


def signorini(gap: float = 0.5, rho: float = 4.0) -> Signorini:
    return Signorini(PAIR, np.array([gap]), np.array([rho]))


def coulomb(friction: float = 0.5, rho: float = 2.0) -> Coulomb:
    return Coulomb(PAIR, np.array([friction]), np.array([rho]))


@given(st.lists(finite, min_size=1, max_size=8), st.integers(0, 2**32 - 1))
def test_projection_obeys_its_variational_inequality(forces, seed):
    """P(f) is the projection iff it is admissible and (f - P)(q - P) <= 0 for every admissible q."""
    rng = np.random.default_rng(seed)
    force = np.array(forces)[:, None]
    limit = rng.uniform(0, 500, size=force.shape) * (rng.random(force.shape) < 0.8)
    nearest = project_on_cone(force, limit)
    assert np.all(np.abs(nearest) <= limit)
    for share in (-1.0, -0.3, 0.0, 0.7, 1.0):
        assert np.all((force - nearest) * (share * limit - nearest) <= 0)


@pytest.mark.parametrize("bad", [-1e-9, np.nan])
def test_a_limit_that_makes_no_cone_is_named(bad):
    limit = np.ones((3, 2))
    limit[2, 1] = bad
    with pytest.raises(ModelError, match="at sample 2 of pair 1; it must not be negative"):
        project_on_cone(np.zeros((3, 2)), limit)


@pytest.mark.parametrize(
    "pressed, opening, residual, partials",
    [
        (9.0, 0.1, 4.0 * 0.6, {("displacement", "normal"): 4.0}),  # pressed harder than it is open: demands gap = 0
        (1.0, 0.1, 1.0, {("force", "normal"): 1.0}),  # wider open than pressed: demands force = 0
        (-3.0, -0.6, -3.0, {("force", "normal"): 1.0}),  # pulls more than it penetrates: still open
        (-0.1, -0.6, 4.0 * -0.1, {("displacement", "normal"): 4.0}),  # penetrates more than it pulls: closed
    ],
)
def test_signorini_in_each_branch(pressed, opening, residual, partials):
    response = signorini().evaluate(at(pressed=pressed, opening=opening))
    assert response.residual[0, 0] == pytest.approx(residual, rel=1e-14)
    assert derivatives(response) == partials


@given(finite, finite, positive)
def test_signorini_vanishes_exactly_on_its_set(pressed, gap, rho):
    """Zero residual means gap >= 0, force >= 0 and no product; every such state has zero residual."""
    law = signorini(gap=0.0, rho=rho)
    residual = law.evaluate(at(pressed=pressed, opening=gap)).residual[0, 0]
    assert residual == pytest.approx(min(pressed, rho * gap), rel=1e-12)
    for force, opening in ((abs(pressed), 0.0), (0.0, abs(gap))):
        assert law.evaluate(at(pressed=force, opening=opening)).residual[0, 0] == 0.0


@given(finite, finite, positive, positive)
def test_admissible_normal_force_is_never_tensile_and_equals_the_force_where_the_law_holds(
    pressed, gap, rho, clearance
):
    law = signorini(clearance, rho)
    fields = law.fields(at(pressed=pressed, opening=gap))
    assert fields["admissible_normal_force"][0, 0] == max(0.0, pressed - rho * (gap + clearance))
    held = law.fields(at(pressed=abs(pressed), opening=-clearance))
    assert held["admissible_normal_force"][0, 0] == pytest.approx(abs(pressed))


def test_a_bond_demands_no_motion():
    law = Bond(PAIR, np.array([7.0]))
    response = law.evaluate(at(pressed=-50.0, opening=0.2))
    assert response.residual[0, 0] == pytest.approx(1.4)
    assert derivatives(response) == {("displacement", "normal"): 7.0}
    assert law.static_target[0] == 0.0


def test_full_stick_targets_close_the_gap():
    assert signorini(gap=0.25).static_target[0] == -0.25
    assert coulomb().static_target is None


@pytest.mark.parametrize(
    "pressed, rub, velocity, residual, partials",
    [
        # sticks: trial 1 - v/2 within the limit 2: demands v = 0
        (4.0, 1.0, 0.6, 0.3, {("velocity", "tangential"): 0.5}),
        (4.0, -1.0, -0.6, -0.3, {("velocity", "tangential"): 0.5}),
        # slips backward (v < 0): friction at +mu lam_N
        (4.0, 1.0, -4.0, -1.0, {("force", "tangential"): 1.0, ("force", "normal"): -0.5}),
        # slips forward (v > 0): friction at -mu lam_N
        (4.0, 1.0, 9.0, 3.0, {("force", "tangential"): 1.0, ("force", "normal"): 0.5}),
        # open, or in tension by truncation: no friction, and no cone turned inside out
        (0.0, 1.0, 0.6, 1.0, {("force", "tangential"): 1.0}),
        (-4.0, 1.0, 0.6, 1.0, {("force", "tangential"): 1.0}),
        (-4.0, -1.0, 9.0, -1.0, {("force", "tangential"): 1.0}),
    ],
)
def test_coulomb_in_each_branch(pressed, rub, velocity, residual, partials):
    response = coulomb().evaluate(at(pressed=pressed, rub=rub, velocity=velocity))
    assert response.residual[0, 0] == pytest.approx(residual, rel=1e-14)
    assert derivatives(response) == partials


@given(finite, finite, st.floats(-1, 1), positive, st.floats(0, 2))
def test_coulomb_vanishes_on_its_set(pressed, velocity, share, rho, friction):
    limit = friction * max(0.0, pressed)
    law = coulomb(friction, rho)
    for force, rate in ((limit, -abs(velocity)), (-limit, abs(velocity)), (share * limit, 0.0)):
        residual = law.evaluate(at(pressed=pressed, rub=force, velocity=rate)).residual[0, 0]
        assert residual == pytest.approx(0.0, abs=1e-12 * (1 + limit))


@given(positive, positive, st.sampled_from([-1.0, 1.0]), positive, st.floats(0.01, 2), st.floats(0, 0.99), positive)
def test_coulomb_vanishes_only_on_its_set(pressed, velocity, sense, rho, friction, share, excess):
    limit = friction * pressed
    law = coulomb(friction, rho)
    evaluate = lambda p, f, v: law.evaluate(at(pressed=p, rub=f, velocity=v)).residual[0, 0]  # noqa: E731
    smallest = 1e-12 * (1 + limit)
    assert abs(evaluate(pressed, sense * (limit + excess), -sense * velocity)) > smallest, "outside the cone"
    assert abs(evaluate(-pressed, sense * excess, 0.0)) > smallest, "friction on an open pair"
    assert abs(evaluate(pressed, sense * limit * share, -sense * velocity)) > smallest, "slips below the limit"
    assert abs(evaluate(pressed, sense * limit, sense * velocity)) > smallest, "slips along its own friction force"


@given(finite, finite, finite, positive, st.floats(0, 2))
def test_admissible_friction_is_within_the_cone_and_the_residual_is_the_distance_to_it(pressed, rub, velocity, rho, mu):
    law = coulomb(mu, rho)
    seen = at(pressed=pressed, rub=rub, velocity=velocity)
    admissible = law.fields(seen)["admissible_friction_force"][0, 0]
    assert abs(admissible) <= mu * max(0.0, pressed)
    assert law.evaluate(seen).residual[0, 0] == pytest.approx(rub - admissible, rel=1e-12, abs=1e-12)


@given(finite, finite, finite, finite, positive, positive, st.floats(0, 2))
def test_derivatives_match_finite_differences_away_from_kinks(pressed, rub, opening, velocity, rho_n, rho_t, mu):
    """Both laws are piecewise linear: central differences within one piece are exact."""
    step = 1e-4
    values = {"pressed": pressed, "rub": rub, "opening": opening, "velocity": velocity}
    trial, limit = rub - velocity / rho_t, mu * max(0.0, pressed)
    margin = 2 * step * (1 + rho_n + 1 / rho_t + mu)
    assume(abs(rho_n * (opening + 0.5) - pressed) > margin and abs(pressed) > margin)
    assume(abs(trial - limit) > margin and abs(trial + limit) > margin)
    keys = {
        ("force", "normal"): "pressed",
        ("force", "tangential"): "rub",
        ("displacement", "normal"): "opening",
        ("velocity", "tangential"): "velocity",
    }
    for law in (signorini(0.5, rho_n), coulomb(mu, rho_t)):
        partials = derivatives(law.evaluate(at(**values)))
        for key, name in keys.items():
            ahead, behind = (
                law.evaluate(at(**values | {name: values[name] + sign * step})).residual[0, 0] for sign in (1, -1)
            )
            scale = 1 + abs(rho_n * opening) + abs(velocity) / rho_t + abs(rub) + abs(pressed)
            assert partials.get(key, 0.0) == pytest.approx((ahead - behind) / (2 * step), rel=1e-9, abs=1e-11 * scale)


def test_pairs_keep_to_themselves():
    """A law with several pairs is the same law at each."""
    rng = np.random.default_rng(0)
    force, other, velocity = rng.normal(size=(3, 6, 4))
    friction, rho = rng.uniform(0.1, 1, size=(2, 4))
    seen = Motion({"normal": other, "tangential": force}, {}, {"tangential": velocity})
    together = Coulomb(np.arange(4), friction, rho).evaluate(seen)
    for k in range(4):
        one = Motion({"normal": other[:, [k]], "tangential": force[:, [k]]}, {}, {"tangential": velocity[:, [k]]})
        alone = Coulomb(PAIR, friction[[k]], rho[[k]]).evaluate(one)
        np.testing.assert_array_equal(together.residual[:, [k]], alone.residual)
        for a, b in zip(together.partials, alone.partials, strict=True):
            np.testing.assert_array_equal(a.values[:, [k]], b.values)
