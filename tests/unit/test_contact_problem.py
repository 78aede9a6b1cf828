"""What a problem calls for: its unknowns by formula, the laws by group of pairs, and how its pairs yield."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import dovetail, friction_oscillator, random_structure

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.errors import ModelError, UnheldBody
from ewr_fenicsx.laws.bonded import Bond
from ewr_fenicsx.laws.coulomb import Coulomb
from ewr_fenicsx.laws.law_kinds import spread_over_pairs
from ewr_fenicsx.laws.unilateral import Signorini
from ewr_fenicsx.problem.composition import compose
from ewr_fenicsx.problem.harmonics import select_basis

PAIRS, COORDINATES, RIGID, N = 6, 26, 3, 4
FULL = 2 * N + 1  # real coefficients a row
LAWS = [
    # normal, tangential, static friction, normal unknowns a pair, tangential unknowns a pair, coordinates held
    ("unilateral", "coulomb", "resolved", FULL, FULL, 0),
    ("unilateral", "coulomb", "zero", FULL, FULL - 1, 0),
    ("unilateral", "frictionless", "resolved", FULL, 0, 0),
    ("unilateral", "bonded", "resolved", FULL, 0, PAIRS),
    ("bonded", "coulomb", "resolved", FULL, FULL, 0),
    ("bonded", "coulomb", "zero", FULL, FULL - 1, 0),
    ("bonded", "frictionless", "resolved", 0, 0, PAIRS),
    ("bonded", "bonded", "resolved", 0, 0, 2 * PAIRS),
    ("prescribed", "coulomb", "resolved", 0, FULL, 0),
    ("prescribed", "coulomb", "zero", 0, FULL - 1, 0),
    ("prescribed", "frictionless", "resolved", 0, 0, 0),
    ("prescribed", "bonded", "resolved", 0, 0, PAIRS),
]


def lay_down(normal: str, tangential: str, static_friction: str = "resolved", **other) -> ContactLaws:
    force = 200.0 if normal == "prescribed" else None
    return ContactLaws(normal, tangential, normal_force=force, static_friction=static_friction, **other)


@pytest.mark.parametrize("normal, tangential, static, per_normal, per_tangential, held", LAWS)
def test_a_combination_has_only_the_unknowns_that_it_needs(
    normal, tangential, static, per_normal, per_tangential, held
):
    """On a grounded structure: no rigid motion counts beside the forces."""
    model = random_structure(size=20, pairs=PAIRS)
    system = compose(ContactProblem(model, lay_down(normal, tangential, static), 0.1, N))
    assert system.model.size == 20 - held and system.expansion.shape == (20, 20 - held)
    rows = PAIRS * ((per_normal > 0) + (per_tangential > 0))
    assert system.rows.shape == (rows, system.model.size)
    if rows:
        assert HarmonicBalance(system).size == PAIRS * (per_normal + per_tangential)
    listed = ContactProblem(model, lay_down(normal, tangential, static), 0.1, range(N + 1))
    assert solve(listed).unknowns == PAIRS * (per_normal + per_tangential)


@pytest.mark.parametrize(
    "normal, tangential, rigid", [("unilateral", "coulomb", 3), ("unilateral", "bonded", 0), ("bonded", "coulomb", 3)]
)
def test_floating_bodies_add_their_rigid_motions_unless_bonds_hold_them(normal, tangential, rigid):
    problem = ContactProblem(dovetail(), lay_down(normal, tangential), 200.0, N)
    balance = HarmonicBalance(problem.system)
    rows = problem.system.rows.shape[0]
    assert balance.size == rows * FULL + rigid


def test_a_given_normal_force_holds_a_floating_body_as_far_as_its_friction_goes():
    """With a coefficient of 0.5 under 2 N: up to 1 N of mean load."""
    rub = ContactLaws("prescribed", normal_force=2.0, friction=0.5)
    floating = friction_oscillator(stiffness=0.0, damping=0.1, load={0: 0.9, 1: 0.05})
    assert solve(ContactProblem(floating, rub, 0.3, 3)).history("friction_force").mean() == pytest.approx(-0.9)
    with pytest.raises(UnheldBody, match="nothing holds a floating body"):
        solve(ContactProblem(replace(floating, load={0: [1.1], 1: [0.05]}), rub, 0.3, 3))


def test_contact_without_a_mean_holds_no_floating_body():
    """It may walk, and nobody would see."""
    model = replace(dovetail(), load={})
    with pytest.raises(ModelError, match=r"holds a floating body, .* only harmonics \(1, 3\): .* add 0 to harmonics"):
        ContactProblem(model, lay_down("bonded", "coulomb"), 200.0, (1, 3)).system  # noqa: B018


@pytest.mark.parametrize("harmonics, coefficients", [(0, 1), (5, 11), ((1, 3, 5), 6), ((0, 2, 5), 5)])
def test_unknowns_by_harmonics(harmonics, coefficients):
    problem = ContactProblem(random_structure(), ContactLaws("bonded", "coulomb"), 0.1, harmonics)
    assert HarmonicBalance(problem.system).size == 6 * coefficients


def test_groups_of_pairs_have_their_own_laws():
    model = dovetail()
    groups = [
        ([0, 3], ContactLaws(friction=0.1, initial_gap=[1e-6, 2e-6])),
        ([1], ContactLaws("bonded", "bonded")),
        ([5, 2], ContactLaws("unilateral", "frictionless")),
        ([4], ContactLaws("bonded", "coulomb", friction=0.7)),
    ]
    system = ContactProblem(model, groups, 200.0, 2).system
    np.testing.assert_array_equal(system.index["normal"], [0, -1, 1, 2, 3, 4])
    np.testing.assert_array_equal(system.index["tangential"], [5, -1, -1, 6, 7, -1])
    np.testing.assert_allclose(
        system.rows @ np.linalg.pinv(system.expansion), _projected(model, system)[[0, 2, 3, 4, 5, 6, 9, 10]]
    )
    assert system.model.size == 24
    np.testing.assert_allclose(np.vstack([model.normal[1], model.tangential[1]]) @ system.expansion, 0.0, atol=1e-14)
    kinds = [(type(law), law.pairs.tolist()) for law in system.laws]
    assert kinds == [(Signorini, [0, 3]), (Coulomb, [0, 3]), (Signorini, [5, 2]), (Bond, [4]), (Coulomb, [4])]
    np.testing.assert_array_equal(system.laws[0].initial_gap, [1e-6, 2e-6])
    np.testing.assert_array_equal(system.laws[4].friction, [0.7])


def _projected(model, system):
    """All contact rows on the motions that the bonds leave, back in the model's own coordinates."""
    return np.vstack([model.normal, model.tangential]) @ system.expansion @ np.linalg.pinv(system.expansion)


def test_weights_follow_each_rows_own_flexibility():
    model = random_structure()
    problem = ContactProblem(model, ContactLaws(), 0.25, 3)
    flexibility = np.array(
        [row @ np.linalg.solve(model.stiffness, row) for row in np.vstack([model.normal, model.tangential])]
    )
    np.testing.assert_allclose(problem.system.flexibility, flexibility, rtol=1e-11)
    signorini, coulomb = problem.system.laws
    scale_n, scale_t = signorini.rho * flexibility[:3], coulomb.rho / (problem.omega * flexibility[3:])
    np.testing.assert_allclose(scale_n, scale_n[0])  # a number of the package's choice, the same for all
    np.testing.assert_allclose(scale_t, scale_t[0])
    given = replace(problem, rho_normal=7.0, rho_tangential=[1.0, 2.0, 3.0]).system.laws
    np.testing.assert_array_equal(given[0].rho, [7.0, 7.0, 7.0])
    np.testing.assert_array_equal(given[1].rho, [1.0, 2.0, 3.0])


def test_a_group_of_no_pairs_costs_nothing():
    """A mask may leave none: laws that hold nowhere keep no harmonics that symmetry makes zero."""
    rubs = ContactLaws(normal="prescribed", normal_force=0.1, friction=0.3, initial_gap=1e-3)
    opens, model = ContactLaws(friction=0.1), friction_oscillator()
    alone, beside = (
        solve(ContactProblem(model, laws, 0.15, 5)) for laws in (rubs, [([0], rubs), ([], opens), ([], rubs)])
    )
    assert beside.unknowns == alone.unknowns > 0 and beside.left_out == alone.left_out == (0, 2, 4)
    np.testing.assert_array_equal(beside.forces, alone.forces)
    assert beside.cautions == alone.cautions


def test_weights_are_given_pair_by_pair_whatever_the_order_of_a_group():
    """The laws' own values come in the order of their group."""
    laws = ContactLaws(friction=[0.1, 0.2, 0.3], initial_gap=[4.0, 5.0, 6.0])
    given = {"rho_normal": [1.0, 2.0, 3.0], "rho_tangential": [7.0, 8.0, 9.0]}
    dashpots = ContactProblem(random_structure(), [([2, 0, 1], laws)], 0.25, 3, **given)
    signorini, coulomb = dashpots.system.laws
    np.testing.assert_array_equal(signorini.rho, [3.0, 1.0, 2.0])
    np.testing.assert_array_equal(signorini.initial_gap, [4.0, 5.0, 6.0])
    np.testing.assert_array_equal(coulomb.rho, [9.0, 7.0, 8.0])
    np.testing.assert_array_equal(coulomb.friction, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(dashpots.friction, [0.2, 0.3, 0.1])
    sprung = replace(dashpots, closure=[0.01, 0.02, 0.03]).system.laws[1]
    np.testing.assert_array_equal(sprung.flexibility, [0.03, 0.01, 0.02])


def test_prescribed_forces_load_the_structure_where_it_has_normal_rows():
    model = replace(random_structure(), load={1: np.arange(9.0)})
    force = {0: 5.0, 1: np.array([1j, 2.0, 0.0])}
    system = ContactProblem(model, ContactLaws("prescribed", "coulomb", normal_force=force), 0.1, 2).system
    np.testing.assert_allclose(system.load[0], model.normal.T @ [5.0, 5.0, 5.0])
    np.testing.assert_allclose(system.load[1], np.arange(9.0) + model.normal.T @ [1j, 2.0, 0.0])
    assert 0 not in model.load and np.all(model.load[1] == np.arange(9.0))


def test_a_group_takes_the_forces_of_its_pairs_from_those_of_all():
    """As it does with friction and gaps."""
    model = random_structure(pairs=3)
    force = {0: [5.0, 6.0, 7.0], 1: [1j, 2.0, 3.0]}
    free = ContactLaws("prescribed", "frictionless", normal_force=0.0)
    groups = [([2, 0], ContactLaws("prescribed", normal_force=force)), ([1], free)]
    given = ContactProblem(model, groups, 0.1, 2).system.prescribed
    np.testing.assert_array_equal(given[0], [5.0, 0.0, 7.0])
    np.testing.assert_array_equal(given[1], [1j, 0.0, 3.0])


@pytest.mark.parametrize(
    "value, expected", [(2.0, [2.0, 2.0]), ([3.0, 4.0], [3.0, 4.0]), ([1, 2, 3, 4, 5], [5.0, 2.0])]
)
def test_values_may_be_one_one_a_group_or_one_a_model(value, expected):
    np.testing.assert_array_equal(spread_over_pairs(value, np.array([4, 1]), 5), expected)


def test_numbers_of_few_digits_cost_no_digits():
    """What is computed from them would have as few in NumPy 2; and the double of an order may be another number."""
    posed = [
        ContactProblem(friction_oscillator(), ContactLaws("prescribed", normal_force=1.0), kind(0.125), 3)
        for kind in (np.float16, np.float32, float)
    ]
    assert [(type(p.frequency), p.omega) for p in posed] == 3 * [(float, 0.25 * np.pi)]
    assert select_basis(np.array([1, 200], dtype=np.uint8), 401).orders == (1, 200)
    with pytest.raises(ModelError, match="samples = 300 cannot resolve harmonic 200; give at least 401"):
        select_basis(np.array([1, 200], dtype=np.uint8), 300)


def test_a_bond_of_a_pair_that_is_clamped_holds_nothing():
    model = random_structure()
    model = replace(model, load={1: np.ones(9)})
    clamped = replace(model, normal=model.normal * [[1.0], [0.0], [1.0]])
    tip, free = (
        solve(ContactProblem(clamped, [([0, 2], ContactLaws("bonded", "frictionless")), ([1], laws)], 0.1, 1))
        for laws in (ContactLaws("bonded", "frictionless"), ContactLaws("prescribed", "frictionless", normal_force=0.0))
    )
    np.testing.assert_allclose(tip.output("tip"), free.output("tip"), rtol=1e-12)
    assert np.all(tip.history("normal_force", 8)[:, 1] == 0)


@pytest.mark.parametrize("tangential", ["frictionless", "bonded"])
def test_bodies_in_space_may_slide_freely_or_not_at_all(tangential):
    model = replace(random_structure(size=16, pairs=3, tangents=2), load={1: np.ones(16)})
    system = ContactProblem(model, ContactLaws(tangential=tangential), 0.1, 2).system
    assert system.model.size == (16 if tangential == "frictionless" else 10)
    if tangential == "bonded":
        np.testing.assert_allclose(model.tangential @ system.expansion, 0.0, atol=1e-14)


def punch(node_mass: float) -> ReducedModel:
    """A body on a contact spring, free to slide along; the contact node between may have no mass."""
    spring = 50.0 * np.array([[0.0, 0.0, 0.0], [0.0, 1.0, -1.0], [0.0, -1.0, 1.0]])
    return ReducedModel(
        mass=np.diag([1.0, 1.0, node_mass]),
        damping=0.01 * spring,
        stiffness=spring,
        normal=[[0.0, 0.0, 1.0]],
        tangential=[[1.0, 0.0, 0.0]],
        load={0: [0.0, -1.0, 0.0], 1: [1.0, 0.0, 0.0]},
        outputs={"along": [1.0, 0.0, 0.0]},
    )


def test_a_row_that_nothing_bends_needs_no_mass_elsewhere():
    """Its own mass is the unit of its weight; a contact node without any is the limit of a light one."""
    laws = ContactLaws(friction=0.3)
    bare, light = (solve(ContactProblem(punch(mass), laws, 0.3, 7)) for mass in (0.0, 1e-7))
    assert bare.merit["J_T"] > 0.01
    here, there = bare.output("along"), light.output("along")
    np.testing.assert_allclose(here, there, atol=1e-5 * abs(there).max())


def test_no_normal_force_at_all_is_no_friction():
    """The mean is then left out by symmetry, though it is given: as zero."""
    model = random_structure()
    model = replace(model, load={1: np.ones(model.size)})
    pressed = ContactProblem(model, ContactLaws("prescribed", normal_force=0.0, friction=0.3), 0.2, 5)
    free = ContactProblem(model, ContactLaws("prescribed", "frictionless", normal_force=0.0), 0.2, 5)
    for name in model.outputs:
        np.testing.assert_allclose(solve(pressed).output(name), solve(free).output(name), rtol=1e-9, atol=1e-12)
    assert solve(pressed).left_out == (0, 2, 4)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3, 1e8])
def test_how_a_pair_yields_does_not_depend_on_the_units_of_coordinates(unit):
    """A free block in its own motion [m] and responses of its pairs, of 1e-8 and 2e-8 m/N, to ``unit`` N.

    In small units they were taken for rigid, and what closes the truncation for a thousand times as much.
    """
    own = np.array([1e-8, 2e-8])
    stiffness = np.diag([0.0, *(own * unit**2)])
    mass = np.diag([1.0, *(1e-3 * own**2 * unit**2)])
    rows = np.column_stack([[1.0, 1.0], np.diag(own * unit)])
    model = ReducedModel(mass, 1e-5 * stiffness, stiffness, 0 * rows, rows, {1: [60.0, 0.0, 0.0]})
    laws = ContactLaws("prescribed", normal_force=50.0, friction=0.3)
    system = ContactProblem(model, laws, 50.0, 9, closure="spring").system
    np.testing.assert_allclose(system.flexibility, own)
    assert system.closures == ("springs",)


def test_how_a_pair_yields_does_not_depend_on_a_suspension_beside_it():
    """A damper of a tenth of a gram on its pairs' springs, beside 1 kg at 1.6 Hz: it was taken for rigid by that."""
    springs, own = np.full(2, 1e10), np.eye(4)
    rows = np.column_stack([np.ones(2), -np.eye(2), np.zeros(2)])
    stiffness, mass = np.diag([0.0, *springs, 100.0]), np.diag([1e-4, 0.0, 0.0, 1.0])
    model = ReducedModel(mass, 0 * mass, stiffness, rows, load={0: -10 * own[0], 1: own[0]})
    system = ContactProblem(model, ContactLaws(tangential="frictionless"), 100.0, 9).system
    np.testing.assert_allclose(system.flexibility, 1 / springs)
