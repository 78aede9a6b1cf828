"""What wears: what is pressed as it slides, by the motion of its surfaces; against closed forms and time stepping."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from small_models import dovetail
from worn_punch import SHARP

from ewr_fenicsx import (
    ContactLaws,
    ContactProblem,
    ReducedModel,
    Tolerance,
    evolve_wear,
    integrate,
    solve,
    solve_to_accuracy,
)
from ewr_fenicsx.output.wear_fields import tabulate_wear_fields
from ewr_fenicsx.problem.dashpots import use_mobility
from ewr_fenicsx.solution.contact_state import STICK, classify_contact
from ewr_fenicsx.wear.archard import measure_wear_rate


def test_what_rings_while_it_sticks_neither_slides_nor_wears():
    """Against time stepping, where a pair that sticks is at rest: two of these six slide, for a third of the period."""
    problem = ContactProblem(dovetail(excitation=100.0), ContactLaws(friction=0.4), 600.0)
    steady = integrate(problem, solve(replace(problem, harmonics=31)), steps=1600, tolerance=1e-6, acceleration=True)
    force, speed = np.maximum(0.0, steady.history("normal_force")), steady.sliding_speed()
    np.testing.assert_array_equal(speed, np.abs(steady.history("slip_velocity")))
    slid, rubbed = speed.mean(axis=0), (force * speed).mean(axis=0)
    assert steady.converged and (speed < 1e-9 * speed.max()).mean() > 0.8
    off = {}
    for n in (5, 9, 15, 41):
        solution = solve(replace(problem, harmonics=n))
        wears = measure_wear_rate(solution, 1.0) * problem.model.pair_area * 600.0
        signals = [solution.history(name) for name in ("normal_force", "slip_velocity")]
        plain = (np.maximum(0.0, signals[0]) * np.abs(signals[1])).mean(axis=0)
        distances = [np.abs(found - rubbed).max() / rubbed.max() for found in (wears, plain)]
        off[n] = (*distances, abs(solution.merit["J_T"] * 600.0 / slid.mean() - 1))
    assert all(own < 0.6 * plain for n, (own, plain, _) in off.items() if n < 41), "the ringing is most of the error"
    assert off[9][0] < 0.12 and off[41][0] < 0.01
    assert off[9][2] < 0.05 and off[41][2] < 0.01


@pytest.mark.parametrize("mean, within", [(-0.8, 0.05), (-0.5, 0.02), (0.0, 0.01)])
def test_what_rings_while_it_is_open_does_not_wear(mean, within):
    """A load that presses for a part of the cycle, on what slides fastest in the middle of the rest.

    It is closed while ``mean + cos(tau) > 0``, and slides as fast as ``sin(tau)`` says.
    """
    load, swing, area, closed = 100.0, 1e-5, 2e-5, -mean
    model = ReducedModel(
        mass=np.zeros((2, 2)),
        damping=np.zeros((2, 2)),
        stiffness=np.diag([1e9, 1e7]),
        normal=[[0.0, 1.0]],
        tangential=[[1.0, 0.0]],
        load={0: [0.0, -load * mean], 1: [1e9 * swing, -load]},
        pair_area=[area],
    )
    exact = 1e-11 * 2 * swing * load / area * (mean * (1 - closed) + 0.5 * (1 - closed**2))
    problem = ContactProblem(model, ContactLaws(tangential="frictionless"), 100.0)
    for n, share in ((5, 1.0), (31, 0.1)):
        history = evolve_wear(replace(problem, harmonics=n), 1, 1e-11)
        assert history.rate[0, 0] == pytest.approx(exact, rel=share * within)
        mean_force = tabulate_wear_fields(history)["mean_pressure"][0, 0] * area
        assert mean_force == pytest.approx(history.solutions[0].pair_forces["normal"][0, 0].real, rel=1e-3)


@pytest.mark.parametrize("closure", ["dashpot", "mass", np.array([1e-6])])
def test_a_pressure_that_rises_as_the_surface_slows_down_wears_by_their_product(closure):
    """A mass without friction under ``100 - 90 sin(2 tau)`` N, which slides at ``cos(tau)``: the mean alone wears.

    Whatever closes the truncation of a friction force that is zero.
    """
    omega = 2 * np.pi * 100.0
    model = ReducedModel(
        mass=np.diag([1.0, 0.0]),
        damping=np.zeros((2, 2)),
        stiffness=np.diag([0.25 * omega**2, 1e7]),
        normal=[[0.0, 1.0]],
        tangential=[[1.0, 0.0]],
        load={0: [0.0, -100.0], 1: [0.75j * omega, 0.0], 2: [0.0, -90j]},
        pair_area=[2e-5],
    )
    solution = solve(ContactProblem(model, ContactLaws(friction=0.0), 100.0, harmonics=3, closure=closure))
    assert solution.history("slip_velocity", 4)[:, 0] == pytest.approx([1.0, 0.0, -1.0, 0.0], abs=1e-12)
    rate = measure_wear_rate(solution, np.array([1e-11]))
    np.testing.assert_allclose(rate, 1e-11 * 100.0 * 2 / np.pi / 2e-5 / 100.0, rtol=1e-5)


def test_sliding_along_both_tangents_wears():
    """A pair in 3-D without friction, driven along the second tangent: four amplitudes a cycle."""
    model = ReducedModel(
        mass=np.eye(3),
        damping=0.1 * np.eye(3),
        stiffness=2 * np.eye(3),
        normal=[[0.0, 0.0, 1.0]],
        tangential=[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        load={0: [0.0, 0.0, -3.0], 1: [0.0, 1.0, 0.0]},
        outputs={"y": [0.0, 1.0, 0.0]},
        pair_area=[0.5],
    )
    solution = solve(ContactProblem(model, ContactLaws(tangential="frictionless"), 0.3, harmonics=1))
    way = 4 * abs(solution.output("y")[1])
    assert solution.merit["J_T"] == pytest.approx(way, rel=1e-3)
    np.testing.assert_allclose(measure_wear_rate(solution, 1e-3), 1e-3 * 3.0 / 0.5 * way, rtol=SHARP)


def pose_partial_slip_in_a_plane() -> ContactProblem:
    """A rigid punch on an elastic line, pressed on by 100 N and pulled at along both tangents: its ends alone slip.

    Coordinates are those of the punch along the tangents and the normal, then those of all nine nodes of the line,
    direction by direction.
    """
    place, eye = np.linspace(-1, 1, 9), np.eye(9)
    flexibility = -1e-8 * np.log(np.abs(place[:, None] - place) / 4 + 0.0625) + 1e-9 * eye
    line = np.linalg.inv(flexibility)
    stiffness = scipy.linalg.block_diag(0.02 * line.sum() * np.eye(3), line, line, line)
    apart = np.hstack([np.kron(np.eye(3), np.ones((9, 1))), -np.eye(27)]).reshape(3, 9, 30)
    model = ReducedModel(
        mass=1e-6 * np.eye(30),
        damping=1.6e-4 * stiffness,
        stiffness=stiffness,
        normal=-apart[2],
        tangential=apart[:2].transpose(1, 0, 2).reshape(18, 30),
        load={0: [0.0, 0.0, 100.0, *np.zeros(27)], 1: [15.0, 1.5j, 2.0, *np.zeros(27)]},
        outputs={"punch": [1.0, *np.zeros(29)]},
        pair_area=np.full(9, 1e-4),
    )
    return ContactProblem(model, ContactLaws(friction=0.3, initial_gap=5e-7 * place**2), 1.0)


def test_partial_slip_in_a_plane_wears_as_accurately_as_asked():
    """With weights by mobility what the dashpots slip is most of it: a tenth was not reached with 63 harmonics."""
    problem, coefficient = pose_partial_slip_in_a_plane(), 1e-11
    rate = lambda s: measure_wear_rate(s, np.full(9, coefficient))  # noqa: E731
    exact = rate(solve(replace(problem, harmonics=41)))
    assert (exact > 0).tolist() == [True, *7 * [False], True]
    weighted = solve(use_mobility(replace(problem, harmonics=9)))
    velocity = [weighted.history(which + "slip_velocity") for which in ("", "second_")]
    force, slips = weighted.pressing_force(), classify_contact(weighted, 1024) != STICK
    truncated = coefficient / 1e-4 * np.mean(force * slips * np.hypot(*velocity), axis=0)
    assert np.abs(truncated - exact).max() > 0.35 * exact.max()
    assert np.abs(rate(weighted) - exact).max() < 0.03 * exact.max()
    found = solve_to_accuracy(problem, 0.1, figure=rate, highest=31)
    assert found.reached and np.abs(rate(found.solution) - exact).max() < 0.1 * exact.max()


@pytest.fixture(scope="module")
def relieved_pad():
    """A pad behind a spring under an interference, shaken along and across: the load dies out as the pad wears."""
    spring, swing = 1e8, 1e-5
    model = ReducedModel(
        mass=np.zeros((2, 2)),
        damping=np.zeros((2, 2)),
        stiffness=np.diag([spring, 1e9]),
        normal=[[1.0, 0.0]],
        tangential=[[0.0, 1.0]],
        load={1: [0.5e-6 * spring, 1e9 * swing * (1 + 1j)]},
        outputs={"along": [0.0, 1.0]},
        pair_area=[1e-5],
    )
    laws = ContactLaws(tangential="frictionless", initial_gap=-1e-6)
    return ContactProblem(model, laws, 100.0, harmonics=3)


def test_wear_that_has_all_but_died_out_takes_no_more_harmonics(relieved_pad):
    """A rate of a two-hundredth of the mean one was to be right within 3 % of itself: 53 harmonics, for as deep."""
    history = evolve_wear(relieved_pad, 10**4, 1e-11, Tolerance(share=0.03), accuracy=0.03, keep_every=500)
    assert 0 < history.rate[-1, 0] < 0.01 * history.depth[-1, 0] / 10**4
    assert history.depth[-1, 0] == pytest.approx(1.496e-6, rel=0.03), "as by 53"
    assert not history.short.size and history.solutions[-1].orders[-1] < 20


def test_a_summary_does_not_tell_of_errors_of_wear_that_has_all_but_died_out(relieved_pad):
    """Told were 30 % of a rate that adds nothing."""
    told = evolve_wear(relieved_pad, 10**4, 1e-11, Tolerance(share=0.03)).summary()
    assert float(re.search(r"the outputs and the wear rate (\S+) ", told)[1]) < 0.01
