"""Sectors with a few coordinates, closed to a ring, against all of them in one model."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, close_ring, solve, unroll_ring
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.model.cyclic_symmetry import CyclicSymmetry
from ewr_fenicsx.model.receptance import find_undamped_modes

LAWS = ContactLaws(normal="prescribed", normal_force=1.0, friction=0.3)


def chain_of_masses(**options) -> ReducedModel:
    """A mass on the ground between two springs, whose ends are the cuts; it rubs in the middle."""
    stiffness = 1e4 * np.array([[1.0, -1.0, 0.0], [-1.0, 2.5, -1.0], [0.0, -1.0, 1.0]])
    given = {
        "tangential": [[0.0, 1.0, 0.0]],
        "load": {1: [0.0, 1.0, 0.5j], 3: [0.0, 0.0, 0.2]},
        "outputs": {"mass": [0.0, 1.0, 0.0], "end": [0.0, 0.0, 1.0], "stretch": [-1.0, 0.0, 1.0]},
    } | options
    return ReducedModel(np.diag([0.05, 1.0, 0.05]), 1e-4 * stiffness, stiffness, **given)


def pose(model):
    weights = {"samples": 60, "rho_tangential": 1e-2, "closure": "dashpot"}  # as many samples as sectors, some times
    return ContactProblem(model, LAWS, frequency=20.0, harmonics=[1, 3, 5], **weights)


@pytest.mark.parametrize(
    ("sectors", "engine_order"), [(2, 0), (2, 1), (3, 1), (3, 2), (6, -1), (6, 2), (6, 3), (6, 13)]
)
def test_a_ring_of_masses_moves_as_all_of_them_do(sectors, engine_order):
    """Loads and outputs at the high cut included, which are of the next sector as well."""
    model = close_ring(chain_of_masses(), [0], [2], sectors=sectors, engine_order=engine_order)
    one, everyone = solve(pose(model)), solve(pose(unroll_ring(model)))
    lag = np.exp(-2j * np.pi * engine_order / sectors * np.array(one.orders))
    assert np.ptp(one.history("slip")) > 1e-6
    moved = np.abs(one.output("mass")).max()
    for name in ("mass", "end", "stretch"):
        for j in range(sectors):
            found = everyone.output(f"{name}_{j}")
            np.testing.assert_allclose(found, lag**j * one.output(name), rtol=0, atol=1e-12 * moved)
    np.testing.assert_allclose(one.output("end"), lag * one.coordinates[:, 0], rtol=1e-12)


def test_a_load_at_the_high_cut_is_one_at_the_next_sectors_low_cut():
    """Its phase there is that of the sector before."""
    low = close_ring(chain_of_masses(load={1: [1.0, 0.0, 0.0]}), [0], [2], sectors=6, engine_order=1)
    high = close_ring(chain_of_masses(load={1: [0.0, 0.0, 1.0]}), [0], [2], sectors=6, engine_order=1)
    np.testing.assert_allclose(high.load[1], np.exp(2j * np.pi / 6) * low.load[1], rtol=1e-14)


def test_damping_that_pushes_the_next_sector_otherwise_than_the_one_before_is_refused():
    """As by a flow. In phase its skew part between the cuts cancels; a ring of sectors would have had another one."""
    flow = np.array([[0.0, 0.0, 3.0], [0.0, 0.0, 0.0], [-3.0, 0.0, 0.0]])
    chain = chain_of_masses()
    sector = replace(chain, damping=chain.damping + flow)
    with pytest.raises(ModelError, match="damping of a sector in a ring is not symmetric: largest difference 6"):
        close_ring(sector, [0], [2], sectors=6, engine_order=1)


@pytest.mark.parametrize("engine_order", [0, 6, 1])
def test_pairs_between_sectors_that_move_alike_are_refused_as_such(engine_order):
    """Masses with gaps between them, which stay where all move in phase; no support or bond holds any."""
    sector = ReducedModel([[1.0]], [[20.0]], [[1e6]], normal=[[-1.0]], load={1: [100.0]})
    model = close_ring(sector, [], [], sectors=6, engine_order=engine_order, normal=[[1.0]])
    problem = ContactProblem(model, ContactLaws(tangential="frictionless", initial_gap=1e-3), frequency=150.0)
    if engine_order == 1:
        assert not solve(problem).touches
        return
    with pytest.raises(ModelError, match=r"row of pair 0, between .* in a wave of 0 nodal diameters"):
        solve(problem)


@pytest.mark.parametrize("frequency", [0.0, 150.0])
def test_an_interference_that_no_mean_motion_relieves_is_refused(frequency):
    """At rest it was left as it is, without a force, in what was called a solution."""
    load = {1: [100.0]} if frequency else {0: [100.0]}
    sector = ReducedModel([[1.0]], [[20.0]], [[1e6]], normal=[[-1.0]], load=load)
    model = close_ring(sector, [], [], sectors=12, engine_order=3, normal=[[1.0]])
    pressed = ContactLaws(tangential="frictionless", initial_gap=-1e-4)
    with pytest.raises(ModelError, match=r"pair 0: an interference between sectors .* nothing relieves it"):
        solve(ContactProblem(model, pressed, frequency))
    behind = ReducedModel(  # the same, behind a spring
        np.diag([1.0, 0.0]), np.diag([20.0, 0.0]), [[2e6, -1e6], [-1e6, 1e6]], normal=[[0.0, -1.0]]
    )
    model = close_ring(behind, [], [], sectors=12, engine_order=3, normal=[[1.0, 0.0]])
    rest = solve(ContactProblem(model, pressed, 0.0))
    assert rest.forces[0, 0].real == pytest.approx(1e6 * 1e-4, rel=1e-6)


def test_outputs_between_sectors_fit_the_model():
    nothing = np.zeros((3, 3))
    with pytest.raises(ModelError, match=r"outputs\['mass'\] between sectors: give 3 finite numbers"):
        CyclicSymmetry(6, 1, nothing, nothing, nothing, outputs={"mass": [1.0, 0.0]})
    with pytest.raises(ModelError, match=r"cyclic has outputs \['other'\] that the model does not have"):
        chain_of_masses(cyclic=CyclicSymmetry(6, 1, nothing, nothing, nothing, outputs={"other": [1.0, 0.0, 0.0]}))


def lattice_sector(count: int, rigid_modes: np.ndarray | None) -> tuple[ReducedModel, np.ndarray]:
    """One of ``count`` sectors of a plane lattice of springs, two nodes at each cut and two between, and its turn."""
    angle = 2 * np.pi / count
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    middle = np.array([np.cos(angle / 2), np.sin(angle / 2)])
    low = np.array([[0.4, 0.0], [0.5, 0.0]])
    places = np.vstack([low, low @ turn.T, 0.4 * middle, 0.5 * middle])
    stiffness = np.zeros((12, 12))
    for i, j in itertools.combinations(range(6), 2):
        along = (places[j] - places[i]) / np.linalg.norm(places[j] - places[i])
        stretch = np.zeros((6, 2))
        stretch[i], stretch[j] = -along, along
        stiffness += 1e6 * np.outer(stretch.ravel(), stretch.ravel())
    if rigid_modes is None:
        shift, spin = np.tile(np.eye(2), (6, 1)), (places @ np.array([[0.0, 1.0], [-1.0, 0.0]])).ravel()
        rigid_modes = np.column_stack([shift, spin]) @ np.array(
            [[1.0, 2.0, 300.0], [1.0, -1.0, 0.0], [0.5, 1.0, 900.0]]
        )
    model = ReducedModel(
        0.5 * np.eye(12), 1e-5 * stiffness, stiffness, tangential=np.eye(12)[8:9], rigid_modes=rigid_modes
    )
    return model, np.kron(np.eye(2), turn)


@pytest.mark.parametrize("given", [True, False])
def test_a_ring_that_floats_turns_and_does_nothing_else_as_a_whole(given):
    """Whatever the sizes and mixtures of the sector's own motions are, found or given."""
    count = 8
    sector, turn = lattice_sector(count, None)
    if not given:
        sector = ReducedModel(sector.mass, sector.damping, sector.stiffness, tangential=sector.tangential)
    ring = close_ring(sector, range(4), range(4, 8), sectors=count, engine_order=1, turn=turn)
    assert ring.rigid_modes.shape == (8, 1)
    radii = np.hypot(*ring.rigid_modes.reshape(-1, 2).T)
    np.testing.assert_allclose(radii / radii[0], np.array([0.4, 0.5, 0.4, 0.5]) / 0.4, rtol=1e-9)
    assert np.abs(ring.stiffness @ ring.rigid_modes).max() < 1e-9 * 1e6 * np.abs(ring.rigid_modes).max()


@pytest.mark.parametrize("engine_order", [1, -1, 7, 2])
def test_a_ring_that_floats_shifts_as_a_whole_in_a_wave_once_round_it(engine_order):
    """What is rubbed is no softer for that: it was found 1e15 times as soft, and friction weighed by thirty times."""
    sector, turn = lattice_sector(8, None)
    ring = close_ring(sector, range(4), range(4, 8), sectors=8, engine_order=engine_order, turn=turn)
    wave = ring.wave_of(1)
    modes = find_undamped_modes(ring, wave)
    assert np.count_nonzero(modes.stiffness == 0.0) == (engine_order != 2)
    expected = 1 / (modes.stiffness + (modes.stiffness == 0.0)) * (modes.stiffness > 0.5)  # all that bends
    by_bending = np.abs(ring.tangential @ modes.shapes) ** 2 @ expected
    found = ContactProblem(ring, LAWS, frequency=20.0).system.flexibility
    assert found == pytest.approx(by_bending, rel=1e-6) and found[0] < 1e-5
