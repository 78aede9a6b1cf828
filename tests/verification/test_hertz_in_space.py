"""A sphere pressed on a plane and rubbed back and forth, pairs with two tangents: Hertz, Cattaneo and Mindlin.

Two elastic half-spaces of one material without Poisson's ratio, for which the closed form is exact: forces in one
direction move no point in another, and in all three by ``1 / r``. Square patches of constant traction are the pairs, as
the strips are in ``test_hertz.py``. In units ``E* = R = 1``, ``P = 4 / 3``: radius ``a = 1``, ``p0 = 2 / pi``.

    pressure      p0 sqrt(1 - r^2),                       a^3 = 3 P R / (4 E*),  p0 = 3 P / (2 pi a^2)
    traction      mu p0 [sqrt(1 - r^2) - c sqrt(1 - r^2/c^2)]   at the largest Q, c^3 = 1 - Q / (mu P)
    approach      d(P) = (3 P / 4)^(2/3)
    shift         s(Q) = mu [d(P) - d(P - Q/mu)]          on first loading; then Masing's loop

Source: Johnson (1985), Contact Mechanics, sections 3.2 (patches), 4.2, 7.2 and 7.4.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from scipy.integrate import quad

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.solution.contact_state import sample_along_tangents
from ewr_fenicsx.solution.solution import PeriodicSolution

FORCE, PRESSURE, FRICTION, PEAK = 4 / 3, 2 / np.pi, 0.3, 0.8  # P, p0, mu, largest Q / (mu P)
LARGEST = PEAK * FRICTION * FORCE
REACH, SUPPORT = 1.2, 1e5  # half-width of the square of patches, beyond which none are pairs; stiffness of the drive


@lru_cache
def place_pairs(across: int) -> np.ndarray:
    """Middles of the patches that lie in the joint, ``(pairs, 2)``."""
    x = REACH * (2 * np.arange(across) + 1 - across) / across
    places = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)
    return places[np.linalg.norm(places, axis=1) < REACH]


def size_of(across: int) -> float:
    """Side of a patch."""
    return 2 * REACH / across


@lru_cache
def measure_compliance(across: int) -> np.ndarray:
    """Displacement of the patches' middles for unit forces on the patches, ``(pairs, pairs)``, in all directions."""
    half, places = size_of(across) / 2, place_pairs(across)
    distance = places[:, None] - places
    total = np.zeros(distance.shape[:2])
    for i, j in ((1, 1), (-1, -1), (1, -1), (-1, 1)):
        x, y = distance[..., 0] + i * half, distance[..., 1] + j * half
        away = np.hypot(x, y)
        total += i * j * (x * np.log(y + away) + y * np.log(x + away))
    return total / (np.pi * (2 * half) ** 2)


def press_sphere(across: int, shift: tuple[float, float] = (0.0, 0.0)) -> ReducedModel:
    """Coordinates: surface displacements, normal and along x and y, then height and shifts of the sphere."""
    n, stiffness = len(place_pairs(across)), np.linalg.inv(measure_compliance(across))
    size = 3 * n + 3
    whole, rows, unit = np.zeros((size, size)), np.zeros((3, n, size)), np.eye(size)
    for k in range(3):
        mine = slice(k * n, (k + 1) * n)
        whole[mine, mine] = 0.5 * (stiffness + stiffness.T)
        rows[k, :, mine], rows[k, :, 3 * n + k] = np.eye(n), 1.0
        whole[3 * n + k, 3 * n + k] = SUPPORT * (k > 0)
    return ReducedModel(
        mass=1e-3 * np.eye(size),
        damping=np.zeros((size, size)),
        stiffness=whole,
        normal=rows[0],
        tangential=np.stack(rows[1:], axis=1).reshape(2 * n, size),
        load={0: -FORCE * unit[3 * n], 1: SUPPORT * (shift[0] * unit[3 * n + 1] + shift[1] * unit[3 * n + 2])},
        outputs={"height": unit[3 * n]},
    )


def initial_gap(across: int) -> np.ndarray:
    return np.sum(place_pairs(across) ** 2, axis=1) / 2


def approach(force: float) -> float:
    return (0.75 * force) ** (2 / 3)


def slide(force: float) -> float:
    """Shift on first loading."""
    return FRICTION * (approach(FORCE) - approach(FORCE - force / FRICTION))


def exact_work() -> float:
    """Area of Masing's loop."""
    return 4 * LARGEST * slide(LARGEST) - 8 * quad(slide, 0, LARGEST)[0]


def shape_hertz(across: int, radius: float) -> np.ndarray:
    return np.sqrt(np.maximum(0.0, radius**2 - np.sum(place_pairs(across) ** 2, axis=1)))


@lru_cache
def press(across: int) -> PeriodicSolution:
    laws = ContactLaws(tangential="frictionless", initial_gap=initial_gap(across))
    return solve(ContactProblem(press_sphere(across), laws, 1e-3, 0))


@lru_cache
def rub(across: int, highest: int, degrees: float) -> PeriodicSolution:
    """Driven slowly along a line by the shift that belongs to half of the friction limit."""
    along = slide(LARGEST) * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    laws = ContactLaws(friction=FRICTION, initial_gap=initial_gap(across))
    return solve(ContactProblem(press_sphere(across, tuple(along)), laws, 1e-3, highest))


def pressure_errors(across: int) -> tuple[float, float, float]:
    """Relative errors of the largest pressure, of the approach, and of the pressure in the root mean square."""
    solution = press(across)
    pressure = solution.history("normal_force", 4)[0] / size_of(across) ** 2
    exact = PRESSURE * shape_hertz(across, 1.0)
    return (
        abs(pressure.max() / exact.max() - 1),
        abs(-solution.output("height")[0].real / approach(FORCE) - 1),
        float(np.sqrt(np.mean((pressure - exact) ** 2)) / PRESSURE),
    )


def traction_errors(across: int, highest: int, degrees: float = 0.0) -> dict[str, float]:
    """Of the force at the peak along the line and across it, of the tractions then, and of the work a cycle."""
    solution = rub(across, highest, degrees)
    turn = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    traction = -sample_along_tangents(solution, "admissible_friction_force", 4)[:, 0] / size_of(across) ** 2
    along, across_it = turn @ traction, np.array([-turn[1], turn[0]]) @ traction
    stick = (1 - PEAK) ** (1 / 3)
    exact = FRICTION * PRESSURE * (shape_hertz(across, 1.0) - shape_hertz(across, stick))
    return {
        "force at the peak": abs(along.sum() * size_of(across) ** 2 / LARGEST - 1),
        "traction at the peak": float(np.sqrt(np.mean((along - exact) ** 2)) / (FRICTION * PRESSURE)),
        "traction across": np.abs(across_it).max() / (FRICTION * PRESSURE),
        "work": abs(solution.merit["friction_dissipation"] / exact_work() - 1),
    }


def test_pressure_and_approach_are_hertzs():
    """By patches as squares see a circle: errors fall, though not evenly."""
    coarse, fine = np.array([pressure_errors(across) for across in (8, 24)])
    assert (fine < (1e-3, 1e-3, 0.01)).all(), fine
    assert (fine < 0.7 * coarse).all(), (coarse, fine)
    places = np.linalg.norm(place_pairs(24), axis=1)
    closed = press(24).history("normal_force", 4)[0] > 1e-9 * FORCE
    assert closed[places < 1 - size_of(24)].all() and not closed[places > 1 + size_of(24)].any()


def test_partial_slip_is_cattaneos_and_mindlins():
    """Along a line at 30 degrees to the tangents, with nothing across it."""
    few, many = traction_errors(12, 9, 30.0), traction_errors(12, 15, 30.0)
    for errors in (few, many):
        assert errors["force at the peak"] < 2e-3
        assert errors["traction at the peak"] < 0.025
        assert errors["traction across"] < 1e-9
    assert many["work"] < 0.06 and many["work"] < 0.8 * few["work"]


def test_friction_has_no_preferred_direction():
    """Turned by any angle, the forces along the line of motion are the same to rounding."""
    tractions = []
    for degrees in (0.0, 30.0, 45.0):
        both = sample_along_tangents(rub(8, 5, degrees), "friction_force", 64)
        tractions.append(both[0] * np.cos(np.radians(degrees)) + both[1] * np.sin(np.radians(degrees)))
    for turned in tractions[1:]:
        np.testing.assert_allclose(turned, tractions[0], atol=1e-9 * np.abs(tractions[0]).max())


def test_the_middle_sticks_and_the_ring_slips():
    """Radius of the stuck disk (1 - Q / (mu P))^(1/3), to a patch."""
    solution = rub(12, 9, 30.0)
    slides = np.ptp(sample_along_tangents(solution, "slip", 256), axis=1).max(axis=0) > 1e-3 * slide(LARGEST)
    places, stick = np.linalg.norm(place_pairs(12), axis=1), (1 - PEAK) ** (1 / 3)
    assert not slides[places < stick - size_of(12)].any() and slides[places > stick + size_of(12)].all()
    assert solution.output("height")[0].real == pytest.approx(-approach(FORCE), rel=3e-3)
