"""One sector of a ring against the whole ring as an ordinary model: waves, solutions, and what is refused."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from ewr_fenicsx import (
    ContactLaws,
    ContactProblem,
    ReducedModel,
    close_ring,
    evolve_wear,
    frequency_response,
    integrate,
    solve,
    unroll_ring,
)
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.in_time.floquet import tell_where_to
from ewr_fenicsx.model.cyclic_symmetry import CyclicSymmetry
from ewr_fenicsx.model.receptance import find_normal_modes
from ewr_fenicsx.output.work_folder import _is_same

CUT, INTERIOR = 2, 5  # coordinates on each cut, and between
LOW = np.arange(4 + INTERIOR, 4 + INTERIOR + CUT)
HIGH = LOW + CUT
SECTORS = 5
RUB = ContactLaws(friction=0.3)
# as many samples from sector to sector, and nothing that is chosen from the model, so that both see the same
ALIKE = {"harmonics": 5, "samples": 32 * SECTORS, "closure": "dashpot", "rho_normal": 1e7, "rho_tangential": 1e-4}


def turn(sectors: int) -> np.ndarray:
    angle = 2 * np.pi / sectors
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def draw_sector(seed: int = 3, coupled_damping: bool = False, shaken: float = 1.0) -> ReducedModel:
    """A pair between coordinates 0, 1 and 2, 3, some coordinates inside, and two on each cut."""
    rng, n = np.random.default_rng(seed), 4 + INTERIOR + 2 * CUT
    mass, stiffness, drag = (a.T @ a for a in rng.normal(size=(3, n + 3, n)))
    load = {0: np.zeros(n), 1: np.zeros(n, complex), 2: np.zeros(n, complex)}
    load[0][0], load[0][HIGH[0]] = -3000.0, 200.0
    load[1][[0, 1, 4]], load[2][5] = shaken * np.array([4000j, 9000, 3000j]), 500 + 100j
    row = lambda a, b: (np.eye(n)[a] - np.eye(n)[b])[None]  # noqa: E731
    damping = 3 * stiffness + 2 * mass + 20 * coupled_damping * drag
    return ReducedModel(0.1 * mass, damping, 1e6 * stiffness, row(0, 2), row(1, 3), load, outputs={"tip": np.eye(n)[1]})


def ring(engine_order: int, sectors: int = SECTORS, **options: object) -> ReducedModel:
    return close_ring(draw_sector(**options), LOW, HIGH, sectors=sectors, engine_order=engine_order, turn=turn(sectors))


@pytest.mark.parametrize("sectors", [2, 3, 4, 5])
def test_modes_of_all_waves_are_those_of_the_whole_ring(sectors):
    model = ring(1, sectors)
    whole = unroll_ring(model)
    of_waves = [
        scipy.linalg.eigh(model.matrix("stiffness", wave), model.matrix("mass", wave), eigvals_only=True)
        for wave in range(sectors)
    ]
    expected = scipy.linalg.eigh(whole.stiffness, whole.mass, eigvals_only=True)
    assert np.sort(np.concatenate(of_waves)) == pytest.approx(expected, rel=1e-9)
    assert not np.allclose(of_waves[0], of_waves[1], rtol=1e-2)
    assert whole.size == sectors * model.size and whole.pairs == sectors and whole.cyclic is None


@pytest.mark.parametrize("coupled_damping", [False, True])
@pytest.mark.parametrize("engine_order", [0, 1, 2, -1, 7])
def test_a_sector_moves_as_those_of_the_whole_ring(engine_order, coupled_damping):
    model = ring(engine_order, coupled_damping=coupled_damping)
    assert (find_normal_modes(model, model.wave_of(1)) is None) == coupled_damping
    one, every = (solve(ContactProblem(m, RUB, frequency=60.0, **ALIKE)) for m in (model, unroll_ring(model)))
    merit, whole = one.merit, every.merit
    assert merit["friction_dissipation"] > 0.1 and abs(merit["energy_error"]) < 1e-3
    for name in ("excitation_work", "viscous_dissipation", "friction_dissipation"):
        assert SECTORS * merit[name] == pytest.approx(whole[name], rel=1e-9)
    for name in ("J_T", "J_N", "largest_normal_force"):  # at 1024 instants, between which the lags fall
        assert merit[name] == pytest.approx(whole[name], rel=1e-3)
    for j in range(SECTORS):
        lag = np.exp(-2j * np.pi * engine_order * j / SECTORS * np.arange(6))
        expected = every.output(f"tip_{j}")
        assert lag * one.output("tip") == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
        assert lag[:, None] * one.forces == pytest.approx(
            every.forces[:, [j, SECTORS + j]], abs=1e-9 * np.abs(one.forces).max()
        )
    own = one.coordinates.shape[1]
    assert one.coordinates == pytest.approx(every.coordinates[:, :own], abs=1e-9 * np.abs(one.coordinates).max())


def shroud(engine_order: int) -> ReducedModel:
    """A second pair between coordinates 4, 5 and the next sector's 6, 7, pressed together."""
    sector, axes, none = draw_sector(), np.eye(4 + INTERIOR + 2 * CUT), np.zeros((1, 4 + INTERIOR + 2 * CUT))
    load = dict(sector.load)
    load[0] = load[0] + 2000 * (axes[4] - axes[6])
    sector = replace(
        sector,
        normal=np.vstack([sector.normal, -axes[4]]),
        tangential=np.vstack([sector.tangential, axes[5]]),
        load=load,
    )
    following = {"normal": np.vstack([none, axes[6]]), "tangential": np.vstack([none, -axes[7]])}
    return close_ring(sector, LOW, HIGH, sectors=SECTORS, engine_order=engine_order, turn=turn(SECTORS), **following)


@pytest.mark.parametrize("engine_order", [0, 1, 2, -1])
def test_pairs_between_sectors_rub_as_in_the_whole_ring(engine_order):
    model = shroud(engine_order)
    one, every = (solve(ContactProblem(m, RUB, frequency=60.0, **ALIKE)) for m in (model, unroll_ring(model)))
    speed = one.sliding_speed(160)
    assert np.all(speed.max(axis=0) > 0.05) and model.joins_sectors
    assert SECTORS * one.merit["friction_dissipation"] == pytest.approx(every.merit["friction_dissipation"], rel=1e-9)
    for name in ("normal_force", "friction_force", "gap", "slip"):
        expected = every.history(name, 160)[:, :2]
        assert one.history(name, 160) == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
    expected = every.output("tip_0")
    assert one.output("tip") == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def test_pairs_between_sectors_are_not_bonded():
    glue = ContactLaws(normal="bonded", tangential="bonded")
    with pytest.raises(ModelError, match="pair 1: bonded, between sectors; let sectors share"):
        solve(ContactProblem(shroud(1), [([0], RUB), ([1], glue)], frequency=60.0))
    solve(ContactProblem(shroud(1), [([1], RUB), ([0], glue)], frequency=60.0))


@pytest.mark.parametrize("engine_order", [1, 2, 3])
def test_masses_that_rub_on_their_neighbours_alone(engine_order):
    """No cut: contact alone joins the sectors, and where all are in phase, as harmonic 3 of order 2, nothing rubs."""
    mass = ReducedModel([[1.0]], [[20.0]], [[1e6]], tangential=[[1.0]], load={1: [100.0]}, outputs={"mass": [1.0]})
    model = close_ring(mass, [], [], sectors=6, engine_order=engine_order, tangential=[[-1.0]])
    pressed = ContactLaws(normal="prescribed", normal_force=100.0, friction=0.3)
    options = {"harmonics": 7, "samples": 240, "closure": "dashpot", "rho_tangential": 1e-3}
    one, every = (solve(ContactProblem(m, pressed, 150.0, **options)) for m in (model, unroll_ring(model)))
    assert one.output("mass") == pytest.approx(every.output("mass_0"), abs=1e-12 * np.abs(one.output("mass")[1]))
    assert (abs(one.output("mass")[3]) < 1e-15) == (engine_order == 2)
    usual = solve(ContactProblem(model, pressed, 150.0, harmonics=7))
    assert usual.problem.system.flexibility == pytest.approx(1e-6 * (2 - 2 * np.cos(np.pi * engine_order / 3)))


def test_bonds_carry_the_same_as_in_the_whole_ring():
    model, glued = ring(2), ContactLaws(normal="bonded", tangential="bonded")
    one, every = (solve(ContactProblem(m, glued, frequency=60.0)) for m in (model, unroll_ring(model)))
    for name in ("normal_force", "friction_force"):
        expected = every.history(name, 60)
        assert one.history(name, 60)[:, 0] == pytest.approx(expected[:, 0], abs=1e-9 * np.abs(expected).max())
        assert np.abs(expected).max() > 100.0


def test_given_normal_forces_travel_round_as_well():
    pressed = ContactLaws(normal="prescribed", normal_force={0: 3000.0, 1: 1000j}, friction=0.3)
    model = replace(ring(1), load={1: ring(1).load[1]})
    one = solve(ContactProblem(model, pressed, frequency=60.0, **ALIKE))
    whole, lag = unroll_ring(model), np.exp(-2j * np.pi / SECTORS * np.arange(SECTORS))
    groups = [([j], replace(pressed, normal_force={0: 3000.0, 1: 1000j * lag[j]})) for j in range(SECTORS)]
    every = solve(ContactProblem(whole, groups, frequency=60.0, **ALIKE))
    expected = every.output("tip_0")
    assert one.output("tip") == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def test_given_harmonics_that_move_sectors_apart_are_not_left_out_for_those_that_do_not():
    """Masses that are pressed apart: by a force that is the same everywhere none moves."""
    mass = ReducedModel([[1.0]], [[20.0]], [[1e6]], [[-1.0]], [[1.0]], load={1: [100.0]})
    model = close_ring(mass, [], [], sectors=6, engine_order=2, normal=[[1.0]], tangential=[[-1.0]])
    pressed = lambda h: ContactLaws(normal="prescribed", normal_force={0: 300.0, h: 80.0}, friction=0.3)  # noqa: E731
    solve(ContactProblem(model, pressed(6), frequency=150.0, harmonics=5))
    with pytest.raises(ModelError, match="the prescribed normal force has a harmonic 7; add it to harmonics"):
        solve(ContactProblem(model, pressed(7), frequency=150.0, harmonics=5))


def test_wear_is_that_of_the_whole_ring():
    model = replace(ring(1, shaken=0.4), pair_area=[1e-6])
    problems = [ContactProblem(m, RUB, frequency=60.0, **ALIKE) for m in (model, unroll_ring(model))]
    one, every = (evolve_wear(problem, cycles=3, coefficient=1e-13) for problem in problems)
    assert one.depth[-1, 0] > 1e-7
    assert one.depth == pytest.approx(every.depth[:, :1], rel=1e-9)


def test_sweeps_and_accuracies_know_of_waves(tmp_path):
    model, frequencies = ring(2, shaken=0.2), np.linspace(50.0, 70.0, 5)
    curve = frequency_response(model, RUB, frequencies, folder=tmp_path / "sweep")
    again = frequency_response(model, RUB, frequencies, folder=tmp_path / "sweep")
    assert np.array_equal(curve.output("tip"), again.output("tip")) and len(curve.frequencies) >= 5
    accurate = solve(ContactProblem(model, RUB, frequency=60.0), accuracy=0.01)
    closest = solve(ContactProblem(model, RUB, frequency=60.0, harmonics=63))
    size = lambda solution: np.linalg.norm(solution.output("tip")[1:])  # noqa: E731
    assert size(accurate) == pytest.approx(size(closest), rel=0.01) and not accurate.short


def test_modes_of_a_wave_that_travels_the_other_way_are_the_conjugate_ones():
    model = ring(1)
    for wave in range(1, SECTORS):
        modes = find_normal_modes(model, wave)
        stiffness, mass = (modes.shapes.conj().T @ model.matrix(n, wave) @ modes.shapes for n in ("stiffness", "mass"))
        np.testing.assert_allclose(mass, np.diag(modes.mass), atol=1e-9 * modes.mass.max())
        np.testing.assert_allclose(stiffness, np.diag(modes.stiffness), atol=1e-9)


def test_modes_of_many_waves_are_found_once(monkeypatch):
    """One after the other, as harmonics come: a cache of a few would forget each before it is needed again."""
    model = ring(1, 100)
    modes = [find_normal_modes(model, wave) for wave in range(60)]
    assert all(find_normal_modes(model, wave) is modes[wave] for wave in range(60))
    monkeypatch.setattr("ewr_fenicsx.model.receptance._MEMORY", 0)
    other = ring(1, 100)
    first, second = ([find_normal_modes(other, wave) for wave in (0, 1)] for _ in range(2))
    assert first[0] is second[0] and first[1] is not second[1]


def test_waves_have_lags_and_diameters():
    ties = CyclicSymmetry(6, -1, *np.zeros((3, 1, 1)))
    assert [ties.wave_of(h) for h in range(7)] == [0, 5, 4, 3, 2, 1, 0]
    assert [ties.count_diameters(w) for w in range(6)] == [0, 1, 2, 3, 2, 1]
    assert ties.lag(0) == 1 and ties.lag(3) == -1 and ties.lag(1) == pytest.approx(np.exp(-1j * np.pi / 3))
    assert "6 sectors, engine order -1" in repr(ties)


def test_products_with_amplitudes_are_those_with_each_waves_matrix(tmp_path):
    model, orders = ring(2), (0, 1, 3, 5)
    rng = np.random.default_rng(1)
    amplitudes = rng.normal(size=(4, model.size)) + 1j * rng.normal(size=(4, model.size))
    for name in ("mass", "damping", "stiffness"):
        expected = [model.matrix(name, model.wave_of(h)) @ x for h, x in zip(orders, amplitudes, strict=True)]
        assert model.react(name, amplitudes, orders) == pytest.approx(np.array(expected), rel=1e-12)
        hermitian, size = model.matrix(name, 2), np.abs(model.matrix(name)).max()
        assert hermitian == pytest.approx(hermitian.conj().T, abs=1e-12 * size)
        assert np.abs(hermitian.imag).max() > 1e-3 * size


def test_a_ring_survives_files_and_pickles(tmp_path):
    model = ring(2)
    rubs = shroud(2)
    rubs.save(tmp_path / "shroud.h5")
    copy = ReducedModel.load(tmp_path / "shroud.h5")
    assert np.array_equal(copy.rows("normal", 2), rubs.rows("normal", 2)) and copy.joins_sectors
    assert _is_same(rubs, copy) and not _is_same(rubs, model)
    model.save(tmp_path / "ring.h5")
    for copy in (ReducedModel.load(tmp_path / "ring.h5"), pickle.loads(pickle.dumps(model))):
        assert (copy.cyclic.sectors, copy.cyclic.engine_order) == (SECTORS, 2)
        assert np.array_equal(copy.matrix("stiffness", 2), model.matrix("stiffness", 2))
        assert _is_same(model, copy)
        with pytest.raises(ValueError, match="read-only"):
            copy.cyclic.stiffness[0, 0] = 1.0
    other = replace(model, cyclic=replace(model.cyclic, engine_order=1))
    assert not _is_same(model, other) and not _is_same(model, replace(model, cyclic=None))
    assert "one of 5 sectors" in repr(model)


def test_what_is_not_known_of_a_ring_is_told():
    problem = ContactProblem(ring(1), RUB, frequency=60.0)
    with pytest.raises(ModelError, match=r"go their own ways; step all of them: unroll_ring\(model\)"):
        integrate(problem)
    assert (
        tell_where_to(problem, alternates=False, multiplier=0)
        == "; integrate(...) on unroll_ring(model) shows where to"
    )


def test_a_free_ring_has_the_rigid_motions_that_its_cuts_let_it():
    """A chain of equal masses in a ring: it turns as a whole, and no other wave is free."""
    bar = np.array([[1.0, -1.0], [-1.0, 1.0]])
    mass, stiffness = np.diag([1.0, 0.5, 0.5]), np.zeros((3, 3))
    stiffness[1:, 1:] += 1e4 * bar
    stiffness[:2, :2] += 1e4 * bar
    sector = ReducedModel(mass, 0 * mass, stiffness, normal=[[1.0, -1.0, 0.0]])
    model = close_ring(sector, [1], [2], sectors=4, engine_order=1)
    assert sector.rigid_modes.shape == (3, 1) and model.rigid_modes.shape == (2, 1)
    assert np.linalg.eigvalsh(model.matrix("stiffness", 1))[0] > 1.0
    assert unroll_ring(model).rigid_modes.shape == (8, 1)


@pytest.mark.parametrize(
    "change, told",
    [
        ({"low": LOW[:1]}, "low has 1 coordinates and high 2"),
        ({"low": [99, 98]}, "low: give the numbers of coordinates, 0 to 12"),
        ({"low": [0.5, 1]}, "low: give the numbers of coordinates"),
        ({"high": []}, "low has 2 coordinates and high 0"),
        ({"normal": np.ones((2, 13))}, r"normal: rows of the next sector have shape \(2, 13\); give \(1, 13\)"),
        ({"normal": np.eye(13)[12:]}, "contact rows on coordinates of the high cut"),
        ({"sector": replace(draw_sector(), tangential=None), "tangential": np.ones((1, 13))}, "the sector has none"),
        ({"high": LOW}, "coordinate 9 is named twice"),
        ({"turn": np.eye(3)}, r"turn has shape \(3, 3\); give \(2, 2\), a rotation"),
        ({"turn": 2 * np.eye(2)}, "a rotation"),
        ({"sectors": 1}, "sectors = 1; a ring has 2 to 1000"),
        ({"sectors": 4.5}, "sectors = 4.5; give a whole number"),
        ({"engine_order": True}, "engine_order = True; give a whole number"),
        ({"sector": ring(1)}, "free at its cuts, not closed already"),
        ({"sector": replace(draw_sector(), normal=np.eye(13)[12:])}, "contact rows on coordinates of the high cut"),
        ({"engine_order": 1.0}, "engine_order = 1.0; give a whole number"),
        ({"engine_order": 10**23}, "give at most 100000 waves, either way"),
        (
            {"sector": replace(draw_sector(), damping=np.triu(np.ones((13, 13))))},
            "damping of a sector in a ring is not",
        ),
    ],
)
def test_what_makes_no_ring_is_refused(change, told):
    asked = {"sector": draw_sector(), "low": LOW, "high": HIGH, "sectors": 5, "engine_order": 1} | change
    with pytest.raises(ModelError, match=told):
        close_ring(asked.pop("sector"), asked.pop("low"), asked.pop("high"), **asked)


def test_couplings_that_do_not_fit_are_refused():
    model = ring(1)
    with pytest.raises(ModelError, match="normal of the next sector needs as many rows as normal of the model has"):
        replace(model, cyclic=replace(model.cyclic, normal=np.ones((2, 11))))
    with pytest.raises(ModelError, match=r"normal of the next sector has shape \(1, 3\)"):
        replace(model.cyclic, normal=np.ones((1, 3)))
    with pytest.raises(ModelError, match="cyclic has matrices of 1 coordinates, and the model 11"):
        replace(model, cyclic=CyclicSymmetry(5, 1, *np.zeros((3, 1, 1))))
    with pytest.raises(ModelError, match="mass is not positive semidefinite"):
        replace(model, cyclic=replace(model.cyclic, mass=100 * model.mass))
    with pytest.raises(ModelError, match="cyclic = 'yes'; give a CyclicSymmetry"):
        replace(model, cyclic="yes")
    with pytest.raises(ModelError, match="between sectors have the shapes"):
        CyclicSymmetry(5, 1, np.zeros((1, 1)), np.zeros((2, 2)), np.zeros((1, 1)))
    with pytest.raises(ModelError, match="give a finite square matrix"):
        CyclicSymmetry(5, 1, np.zeros((1, 2)), np.zeros((1, 1)), np.zeros((1, 1)))
    with pytest.raises(ModelError, match="give a sector of a ring"):
        unroll_ring(draw_sector())
    with pytest.raises(ModelError, match="1000 sectors with 11 coordinates each are 11000, more than 8000"):
        unroll_ring(close_ring(draw_sector(), LOW, HIGH, sectors=1000, engine_order=1))
