"""Laws and problems that make no sense, or do not fit their model, are refused with what to give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import friction_oscillator, lift_off_oscillator, random_structure

from ewr_fenicsx import ContactLaws, ContactProblem, solve
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.laws.law_kinds import spread_over_pairs


def test_other_counts_of_values_are_refused():
    with pytest.raises(ModelError, match="3 values for 2 pairs; give one, or one a pair"):
        spread_over_pairs([1.0, 2.0, 3.0], np.array([4, 1]), 5)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"normal": "unilatral"}, 'normal = "unilatral"; choose one of .*; did you mean "unilateral"'),
        ({"tangential": "sticky"}, 'tangential = "sticky"; choose one of "bonded", "coulomb", "frictionless"'),
        ({"static_friction": "nought"}, 'static_friction = "nought"'),
        ({"friction": -0.1}, "friction = -0.1; it must be finite and not negative"),
        ({"friction": np.nan}, "friction = nan; it must be finite"),
        ({"initial_gap": [0.0, -np.inf]}, r"initial_gap\[1\] = -inf; it must be finite"),
        ({"normal": ["unilateral"]}, r"normal = .*; choose one of "),
        ({"parameters": None}, "parameters = None; give a dictionary such as"),
        ({"parameters": {"friction": 0.5}}, r'parameters\["friction"\] is an argument of its own; give friction = '),
        ({"parameters": {"static_friction": "off"}}, "is an argument of its own; give static_friction = "),
        ({"normal": "prescribed", "normal_force": 1.0, "parameters": {"normal_force": 2.0}}, "give normal_force = "),
        ({"normal": "prescribed"}, "give both or neither"),
        ({"normal_force": 1.0}, "give both or neither"),
        ({"normal": "prescribed", "normal_force": -50.0}, "normal_force has the mean -50.0; it must be real, finite"),
        ({"normal": "prescribed", "normal_force": {0: [1.0, -2.0], 1: 5.0}}, r"mean \[1.0, -2.0\]; .* not negative"),
        ({"friction": 0.3 + 0j}, r"friction = \(0.3\+0j\) is complex; give real numbers"),
        ({"friction": "0.3"}, "friction = '0.3'; give numbers"),
        ({"friction": None}, "friction = None; give numbers"),
        ({"initial_gap": [[0.0], 1.0]}, "initial_gap = .* has rows of unequal lengths"),
        ({"normal": "prescribed", "normal_force": "5 N"}, r"normal_force\[0\] = '5 N'; give numbers"),
        ({"normal": "prescribed", "normal_force": {0.5: 1.0}}, "normal_force has a harmonic 0.5; harmonics are whole"),
        ({"normal": "prescribed", "normal_force": {1: np.inf}}, "amplitude inf at harmonic 1; it must be finite"),
        ({"normal": "prescribed", "normal_force": {0: 1j}}, "normal_force has the mean 1j; it must be real"),
    ],
)
def test_laws_that_make_no_sense_are_refused(arguments, message):
    with pytest.raises(ModelError, match=message):
        ContactLaws(**arguments)


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"frequency": -1.0}, "frequency = -1.0 Hz; give a positive one"),
        ({"frequency": np.nan}, "frequency = nan Hz"),
        ({"frequency": "140"}, "frequency = '140'; give a number of Hz"),
        ({"frequency": None}, "frequency = None; give a number of Hz"),
        ({"rho_normal": 0.0}, "rho_normal = 0; it must be positive"),
        ({"rho_tangential": [-1.0]}, r"rho_tangential\[0\] = -1; it must be positive"),
        ({"rho_tangential": [1.0, 1.0]}, "rho_tangential has 2 values for 1 pairs; give one, or one a pair"),
        ({"rho_tangential": np.inf}, "rho_tangential = inf; it must be positive and finite, or None"),
        ({"rho_normal": [np.inf]}, r"rho_normal\[0\] = inf; it must be positive and finite"),
        ({"rho_normal": "stiff"}, "rho_normal = 'stiff'; give numbers"),
        ({"wear": [np.nan]}, r"wear\[0\] = nan; give one finite depth >= 0 \[m\] for each of the 1 pairs"),
        ({"wear": [0.0, 0.0]}, r"wear has the shape \(2,\); give one finite depth >= 0 \[m\] for each of the 1 pairs"),
        ({"wear": ["deep"]}, r"wear = \['deep'\]; give numbers"),
        ({"frequency": 1e300}, r"frequency = 1e\+300 Hz; give a positive one from 1e-100 to 1e\+100 Hz"),
        ({"frequency": 1e-300}, "frequency = 1e-300 Hz; give a positive one"),
        ({"model": ContactLaws()}, "model = ContactLaws.*; give a ReducedModel"),
        ({"laws": None}, "laws has None; give one ContactLaws for all pairs"),
        (
            {"laws": [([0.5], ContactLaws())]},
            "laws must cover each of the 1 pairs once; they leave out pair 0 and name, though it is none, pair 0.5",
        ),
        ({"laws": [([0], ContactLaws()), ([0], ContactLaws())]}, "each of the 1 pairs once; they repeat pair 0$"),
        ({"laws": [("all", ContactLaws())]}, "pairs of laws = 'all'; give numbers"),
        (
            {"laws": [(np.array([False]), ContactLaws())]},
            r"array\(\[False\]\); give numbers, as np.flatnonzero makes of",
        ),
        ({"load": {1: [1e-165, 0.0, 0.0, 0.0]}}, r"largest entry is 1e-165 N; give 1e-100 to 1e\+100 N, .* or none"),
        ({"load": {0: [1e160, 0.0, 0.0, 0.0]}}, r"largest entry is 1e\+160 N; give 1e-100"),
        ({"harmonics": (0, 2)}, r"loaded at harmonics \[1\], the problem keeps only \(0, 2\); add them"),
        ({"harmonics": (1, 3)}, r"loaded at harmonics \[0\], the problem keeps only \(1, 3\)"),
        (
            {"harmonics": (1, 3), "load": {1: np.ones(4)}},
            r"pair 0 may part, and the problem keeps only harmonics \(1, 3\): .* pulls as much as it pushes; add 0",
        ),
        ({"generalised_inverse": "pined"}, "generalised_inverse = 'pined'; choose one of inertia relief, pinned"),
        ({"load": [1.0, 2.0, 3.0, 4.0]}, r"load = \[1.0, 2.0, 3.0, 4.0\]; give a dictionary such as {1: amplitudes}"),
        ({"load": {1: [1.0, 2.0, 3.0]}}, r"load\[1\] has 3 entries; expected 4"),
        ({"load": {0: [1j, 0.0, 0.0, 0.0]}}, r"load\[0\] is the mean load and must be real"),
        ({"load": {1: [np.nan, 0.0, 0.0, 0.0]}}, r"load\[1\] has entries that are not finite"),
        ({"load": {-1: np.ones(4)}}, "harmonic -1; harmonics are whole numbers from 0"),
        ({"samples": 10}, "samples = 10 cannot resolve harmonic 5; give at least 11"),
    ],
)
def test_problems_that_make_no_sense_are_refused(changes, message):
    arguments = {"model": lift_off_oscillator(), "laws": ContactLaws(), "frequency": 0.1} | changes
    with pytest.raises(ModelError, match=message):
        ContactProblem(**arguments)


@pytest.mark.parametrize(
    "model, laws, message",
    [
        (friction_oscillator(), ContactLaws(), "needs normal contact rows"),
        (random_structure(tangents=0), ContactLaws(), "needs tangential contact rows"),
        (
            random_structure(),
            ContactLaws("prescribed", normal_force={0: 1.0, 9: 1.0}),
            "has a harmonic 9; add it to harmonics",
        ),
        (random_structure(), ContactLaws(friction=[0.1, 0.2]), "friction has 2 values for 3 pairs; give one, or one a"),
        (random_structure(), ContactLaws(friction=[[0.1, 0.2, 0.3]]), r"friction has the shape \(1, 3\) for 3 pairs; "),
        (random_structure(), ContactLaws(initial_gap=[0.1, 0.2]), "initial_gap has 2 values for 3 pairs"),
        (random_structure(), ContactLaws("prescribed", normal_force=[1, 2]), "normal_force has 2 values for 3 pairs"),
        (random_structure(), ContactLaws("prescribed", normal_force={0: 9, 1: [1j, 2]}), "normal_force has 2 values"),
        (random_structure(), [([0, 1], ContactLaws())], "cover each of the 3 pairs once; they leave out pair 2$"),
        (random_structure(), [([0, 1, 2, 2], ContactLaws())], "they repeat pair 2$"),
    ],
)
def test_laws_that_do_not_fit_the_model_are_refused(model, laws, message):
    with pytest.raises(ModelError, match=message):
        ContactProblem(model, laws, 0.1).system  # noqa: B018


def test_a_pair_that_nothing_can_move_is_named():
    model = random_structure()
    clamped = replace(model, normal=model.normal * [[1.0], [0.0], [1.0]])
    with pytest.raises(ModelError, match=r"the normal row of pair 1 moves with no coordinate: .* prescribe its normal"):
        ContactProblem(clamped, ContactLaws(), 0.1).system  # noqa: B018
    ContactProblem(clamped, ContactLaws("prescribed", normal_force=1.0), 0.1).system  # noqa: B018  the remedy
    clamped = replace(model, tangential=model.tangential * [[1.0], [0.0], [1.0]])
    assert ContactProblem(clamped, ContactLaws(), 0.1).system.index["tangential"].tolist() == [3, -1, 4], "it rests"


@pytest.mark.parametrize("seed", range(4))
def test_a_pair_that_bonds_of_others_hold_is_named(seed):
    """As where two flanks share a corner. Rounding left of its row something that took forces of 1e15 N to move."""
    model = random_structure(seed=seed)
    normal, tangential = model.normal.copy(), model.tangential.copy()
    normal[2], tangential[2] = 0.7 * normal[0], 0.7 * tangential[0]
    model = replace(model, normal=normal, tangential=tangential, load={0: np.ones(9), 1: np.ones(9)})
    bonds, rubs = ContactLaws("bonded", "bonded"), ContactLaws()
    with pytest.raises(ModelError, match=r"the normal row of pair 2 .* held by bonds of others already"):
        solve(ContactProblem(model, [([0], bonds), ([1, 2], rubs)], 0.1))
    sticks = ContactLaws("prescribed", "bonded", normal_force=1.0)
    with pytest.raises(ModelError, match="the tangential row of pair 2 moves"):
        solve(ContactProblem(model, [([0], sticks), ([1, 2], ContactLaws("prescribed", normal_force=1.0))], 0.1))


def test_a_given_force_that_the_samples_do_not_resolve_is_refused():
    """Where it acts on nothing but the limit of friction its harmonics need not be kept, but samples must see them."""
    swings = lambda h: ContactLaws("prescribed", normal_force={0: 0.8, h: 0.6}, friction=0.5)  # noqa: E731
    problem = ContactProblem(friction_oscillator(damping=0.05), swings(65), 0.1, (1, 3))
    with pytest.raises(ModelError, match=r"harmonic 65, which samples = 128 a period .*; give at least 131"):
        solve(problem)
    few, many = (solve(replace(problem, samples=samples)).output("tip") for samples in (131, 4096))
    np.testing.assert_allclose(few, many, rtol=0.03)
    at_rest = ContactProblem(friction_oscillator(load={0: 1.0}), swings(1), 0.0)
    with pytest.raises(ModelError, match="has a harmonic 1; give a positive frequency"):
        solve(at_rest)
