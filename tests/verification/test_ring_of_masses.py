"""A ring of equal masses: its waves have closed forms, and masses that move in turn rub as a single one does.

Masses ``m`` on springs ``k`` with springs ``c`` between neighbours: wave ``w`` of ``N`` has
``omega^2 = (k + 4 c sin^2(pi w / N)) / m``. Under engine order ``N / 2`` neighbours move against each other; where each
rubs on both of them with a largest force ``F / 2``, and slips by twice its motion, it is Den Hartog's mass with ``F``.
"""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from test_den_hartog import exact_amplitude, largest_slip

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, close_ring, solve
from ewr_fenicsx.problem.closure import compare_waves
from ewr_fenicsx.solution.solution import PeriodicSolution

SPRING, BETWEEN = 3.0, 2.0  # N/m; the mass is 1 kg


def ring_of_springs(sectors: int) -> ReducedModel:
    """A sector is a mass on a spring, and the spring to the next mass, where its other coordinate is."""
    stiffness = [[SPRING + BETWEEN, -BETWEEN], [-BETWEEN, BETWEEN]]
    sector = ReducedModel(np.diag([1.0, 0.0]), np.zeros((2, 2)), stiffness, tangential=[[1.0, 0.0]])
    return close_ring(sector, [0], [1], sectors=sectors, engine_order=1)


def frequency_error(sectors: int) -> float:
    """Largest relative error of a wave's angular frequency."""
    model, waves = ring_of_springs(sectors), np.arange(sectors)
    exact = np.sqrt(SPRING + 4 * BETWEEN * np.sin(np.pi * waves / sectors) ** 2)
    pencils = [(model.matrix("stiffness", wave), model.matrix("mass", wave)) for wave in waves]
    found = np.sqrt([scipy.linalg.eigh(*pencil, eigvals_only=True)[0] for pencil in pencils])
    return float(np.abs(found / exact - 1).max())


def rub_in_turn(beta: float, friction: float, highest: int, sectors: int = 6) -> PeriodicSolution:
    """Masses that only friction joins, in the units of Den Hartog; they slip by twice their motion."""
    mass = ReducedModel([[1.0]], [[0.0]], [[1.0]], tangential=[[1.0]], load={1: [1.0]}, outputs={"x": [1.0]})
    model = close_ring(mass, [], [], sectors=sectors, engine_order=sectors // 2, tangential=[[-1.0]])
    laws = ContactLaws("prescribed", normal_force=friction / 2, friction=1.0)
    return solve(ContactProblem(model, laws, beta / (2 * np.pi), highest, samples=64 * highest, closure="spring"))


@pytest.mark.parametrize("sectors", [2, 3, 4, 7, 100])
def test_waves_have_their_frequencies(sectors):
    assert frequency_error(sectors) < 1e-13


@pytest.mark.parametrize("beta, friction", [(0.8, 0.4), (1.25, 0.3), (0.6, 0.2)])
def test_masses_that_move_in_turn_rub_as_den_hartogs(beta, friction):
    errors = [largest_slip(rub_in_turn(beta, friction, n)) / 2 / exact_amplitude(beta, friction) - 1 for n in (7, 31)]
    assert abs(errors[1]) < 2e-3 and abs(errors[1]) < 0.5 * abs(errors[0]), errors
    solution = rub_in_turn(beta, friction, 31)
    work = 4 * friction * exact_amplitude(beta, friction)
    assert solution.merit["friction_dissipation"] == pytest.approx(work, rel=5e-3)


def rub_on_neighbours(stiffness: list, mass: list, closure: str, highest: int) -> PeriodicSolution:
    """Thirty blades that rub on both neighbours by their last coordinate, in a wave once round the ring."""
    end, first = np.eye(len(mass))[-1:], np.eye(len(mass))[0]
    sector = ReducedModel(np.diag(mass), np.diag([20.0 * m for m in mass]), stiffness, tangential=end,
                          load={1: 100.0 * first}, outputs={"x": first})  # fmt: skip
    model = close_ring(sector, [], [], sectors=30, engine_order=1, tangential=-end)
    laws = ContactLaws("prescribed", normal_force=635.0, friction=0.3)
    return solve(ContactProblem(model, laws, 150.0, highest, samples=1024, closure=closure))


@pytest.mark.parametrize(
    "stiffness, mass, closure", [([[1e6]], [1.0], "mass"), ([[1.3e6, -3e5], [-3e5, 3e5]], [1.0, 0.0], "spring")]
)
def test_neighbours_that_all_but_move_together_are_closed_as_they_move_beyond(stiffness, mass, closure):
    """As they move at harmonic 1, five harmonics are off by 5 and 4 per cent."""
    few, many = (rub_on_neighbours(stiffness, mass, closure, n) for n in (5, 127))
    lack = many.output("x")
    lack[[many.orders.index(h) for h in few.orders]] -= few.output("x")
    assert np.linalg.norm(lack) < 0.01 * np.linalg.norm(many.output("x"))


def test_harmonics_left_out_are_seen_in_their_own_waves():
    mass = ReducedModel([[1.0]], [[0.0]], [[1.0]], tangential=[[1.0]])
    model = close_ring(mass, [], [], sectors=30, engine_order=1, tangential=[[-1.0]])
    apart = lambda h: 4 * np.sin(np.pi * h / 30) ** 2  # noqa: E731
    expected = np.mean([apart(h) for h in (7, 9, 11)]) / apart(1)
    read = lambda wave: model.rows("tangential", wave)  # noqa: E731
    assert compare_waves(model, read, 1.0, 5) == pytest.approx(expected, rel=1e-9)


def test_masses_that_move_alike_do_not_rub():
    """In phase a pair between sectors sees nothing: the row moves with no coordinate."""
    mass = ReducedModel([[1.0]], [[0.1]], [[1.0]], tangential=[[1.0]], load={1: [1.0]}, outputs={"x": [1.0]})
    model = close_ring(mass, [], [], sectors=6, engine_order=0, tangential=[[-1.0]])
    laws = ContactLaws("prescribed", normal_force=0.4, friction=1.0)
    solution = solve(ContactProblem(model, laws, 0.8 / (2 * np.pi)))
    assert solution.merit["friction_dissipation"] == 0.0
    assert solution.output("x")[1] == pytest.approx(1 / (1 - 0.64 + 0.08j), rel=1e-12)
