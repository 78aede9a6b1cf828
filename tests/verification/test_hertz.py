"""A cylinder pressed on a plane and rubbed back and forth: Hertz, and Cattaneo and Mindlin.

Two elastic half-planes of one material, in the small-displacement approximation that Hertz made too: flat, with the
initial gap ``x^2 / (2 R)``. Their compliance is Flamant's, integrated over strips of constant traction, one a pair:
matrices that come from no mesh. In units ``E* = R = 1``, ``P = pi / 4``: half-width ``a = 1``, ``p0 = 1/2``.

    pressure      p0 sqrt(1 - x^2),                       a = sqrt(4 P R / (pi E*)),  p0 = 2 P / (pi a)
    traction      mu p0 [sqrt(1 - x^2) - c sqrt(1 - x^2/c^2)]   at the largest Q, c = sqrt(1 - Q / (mu P))
    approach      d(P) = P / (pi E*) [1 + 2 ln(2 D / a)], D the distance where the half-plane is held
    shift         s(Q) = mu [d(P) - d(P - Q/mu)]          on first loading; then Masing's loop

One material on both sides: normal and tangential problem are coupled by friction alone.

Source: Johnson (1985), Contact Mechanics, sections 4.2, 7.2 and 7.4; for the shift Ciavarella (1998),
doi:10.1016/S0020-7683(97)00154-6.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.solution.solution import PeriodicSolution

FORCE, PRESSURE, FRICTION, PEAK = np.pi / 4, 0.5, 0.3, 0.5  # P, p0, mu, largest Q / (mu P)
LARGEST = PEAK * FRICTION * FORCE
HELD, REACH, SUPPORT = 50.0, 1.2, 1e5  # distance D, half-width of the joint, stiffness of the drive


def place_pairs(pairs: int) -> np.ndarray:
    """Middles of the strips, ``(pairs,)``."""
    return REACH * (2 * np.arange(pairs) + 1 - pairs) / pairs


def measure_compliance(pairs: int) -> np.ndarray:
    """Displacement of the strips' middles for unit forces on the strips, ``(pairs, pairs)``."""
    x, width = place_pairs(pairs), 2 * REACH / pairs
    integral = lambda t: t * np.log(np.abs(t) / HELD) - t  # noqa: E731
    distance = x[:, None] - x
    return -2 / (np.pi * width) * (integral(distance + width / 2) - integral(distance - width / 2))


def press_cylinder(pairs: int, shift: float = 0.0) -> ReducedModel:
    """Coordinates: normal and tangential surface displacements, then the height and the shift of the cylinder."""
    n, stiffness = pairs, np.linalg.inv(measure_compliance(pairs))
    stiffness = 0.5 * (stiffness + stiffness.T)
    normal, tangential = np.zeros((n, 2 * n + 2)), np.zeros((n, 2 * n + 2))
    normal[:, :n], normal[:, 2 * n] = np.eye(n), 1.0
    tangential[:, n : 2 * n], tangential[:, 2 * n + 1] = np.eye(n), 1.0
    whole, unit = np.zeros((2 * n + 2, 2 * n + 2)), np.eye(2 * n + 2)
    whole[:n, :n] = whole[n : 2 * n, n : 2 * n] = stiffness
    whole[-1, -1] = SUPPORT
    return ReducedModel(
        mass=1e-3 * np.eye(2 * n + 2),
        damping=np.zeros((2 * n + 2, 2 * n + 2)),
        stiffness=whole,
        normal=normal,
        tangential=tangential,
        load={0: -FORCE * unit[2 * n], 1: SUPPORT * shift * unit[-1]},
        outputs={"height": unit[2 * n], "shift": unit[-1]},
    )


def initial_gap(pairs: int) -> np.ndarray:
    return place_pairs(pairs) ** 2 / 2


def approach(force: float) -> float:
    """Of the half-planes under a force, the held distance away."""
    return force / np.pi * (1 + 2 * np.log(2 * HELD / np.sqrt(4 * force / np.pi)))


def slide(force: float) -> float:
    """Tangential shift on first loading."""
    return FRICTION * (approach(FORCE) - approach(FORCE - force / FRICTION))


@lru_cache
def press(pairs: int) -> PeriodicSolution:
    laws = ContactLaws(tangential="frictionless", initial_gap=initial_gap(pairs))
    return solve(ContactProblem(press_cylinder(pairs), laws, 1e-3, 0))


@lru_cache
def rub(pairs: int, highest: int) -> PeriodicSolution:
    """Driven slowly by the shift that belongs to half of the friction limit."""
    model = press_cylinder(pairs, slide(LARGEST))
    laws = ContactLaws(friction=FRICTION, initial_gap=initial_gap(pairs))
    return solve(ContactProblem(model, laws, 1e-3, highest))


def exact_traction(pairs: int, force: float) -> np.ndarray:
    """``(pairs,)`` at a force on the way down from the peak; at the peak itself it is Cattaneo's."""
    half = lambda c: np.sqrt(np.maximum(0.0, c**2 - place_pairs(pairs) ** 2))  # noqa: E731
    stick = np.sqrt(1 - (LARGEST - force) / (2 * FRICTION * FORCE))
    return FRICTION * PRESSURE * (-half(1.0) + 2 * half(stick) - half(np.sqrt(1 - PEAK)))


def exact_work() -> float:
    """Area of Masing's loop."""
    return 4 * LARGEST * slide(LARGEST) - 8 * quad(slide, 0, LARGEST)[0]


def exact_force_without_shift() -> float:
    """Where the loop crosses a shift of zero on the way down."""
    return brentq(lambda force: slide(LARGEST) - 2 * slide((LARGEST - force) / 2), -LARGEST, LARGEST)


def exact_pressure(pairs: int) -> np.ndarray:
    return PRESSURE * np.sqrt(np.maximum(0.0, 1 - place_pairs(pairs) ** 2))


def pressure_errors(pairs: int) -> tuple[float, float, float]:
    """Relative errors of the largest pressure, of the approach, and of the pressure in the root mean square."""
    solution = press(pairs)
    pressure = solution.history("normal_force", 4)[0] * pairs / (2 * REACH)
    return (
        abs(pressure.max() / exact_pressure(pairs).max() - 1),
        abs(-solution.output("height")[0].real / approach(FORCE) - 1),
        float(np.sqrt(np.mean((pressure - exact_pressure(pairs)) ** 2)) / PRESSURE),
    )


def traction_errors(pairs: int, highest: int) -> dict[str, float]:
    """Of the force at the peak and where the shift is zero, of the tractions then, and of the work a cycle."""
    solution, width = rub(pairs, highest), 2 * REACH / pairs
    traction = -solution.history("admissible_friction_force", 4)[:2] / width
    force = width * traction.sum(axis=1)
    miss = lambda k, at: np.abs(traction[k] - exact_traction(pairs, at)).max() / (FRICTION * PRESSURE)  # noqa: E731
    return {
        "force at the peak": abs(force[0] / LARGEST - 1),
        "force without shift": abs(force[1] - exact_force_without_shift()) / LARGEST,
        "traction at the peak": miss(0, LARGEST),
        "traction without shift": miss(1, force[1]),
        "work": abs(solution.merit["friction_dissipation"] / exact_work() - 1),
    }


def test_the_exact_solution_is_one():
    """Of the test itself: tractions add up to the force, the first loading's slope is the stuck stiffness."""
    strips = 4800
    for force in (LARGEST, 0.2 * LARGEST, -0.7 * LARGEST):
        assert exact_traction(strips, force).sum() * 2 * REACH / strips == pytest.approx(force, abs=1e-5)
    assert exact_pressure(strips).sum() * 2 * REACH / strips == pytest.approx(FORCE, rel=1e-5)
    stuck = 2 / np.pi * np.log(2 * HELD)  # shift of a bonded strip of half-width 1 for a unit force
    assert slide(1e-6) / 1e-6 == pytest.approx(stuck, rel=1e-4)


def test_pressure_half_width_and_approach_are_hertzs():
    """Largest pressure and approach converge with the square of the strip, the pressure at the edge linearly."""
    errors = np.array([pressure_errors(pairs) for pairs in (24, 48, 96)])
    rates = np.log2(errors[:-1] / errors[1:])
    np.testing.assert_allclose(rates[:, 0], 2, atol=0.3)
    np.testing.assert_allclose(rates[:, 1], 2, atol=0.15)
    np.testing.assert_allclose(rates[:, 2], 1, atol=0.1)
    assert (errors[-1] < (3e-5, 2e-5, 2.5e-3)).all(), errors
    for pairs in (24, 48, 96):
        closed = press(pairs).history("normal_force", 4)[0] > 1e-9 * FORCE
        np.testing.assert_array_equal(closed, np.abs(place_pairs(pairs)) < 1, err_msg="the half-width is 1")


def test_forces_carry_the_load_and_gaps_are_open_beyond():
    solution = press(48)
    force, gap = solution.history("normal_force", 4)[0], solution.history("gap", 4)[0]
    assert force.sum() == pytest.approx(FORCE, rel=1e-9)
    assert force.min() >= -1e-12 and gap.min() > -1e-12 and np.abs(force * gap).max() < 1e-12
    x = np.abs(place_pairs(48))
    beyond = x > 1
    exact = (x * np.sqrt(np.maximum(x**2 - 1, 0)) - np.arccosh(np.maximum(x, 1))) / 2
    np.testing.assert_allclose(gap[beyond], exact[beyond], rtol=0, atol=6e-4)


def test_partial_slip_is_cattaneos_and_mindlins():
    """Tractions and force at the peak and on the way down, work a cycle: strips and harmonics refined together.

    Measured with 48 pairs and N = 31: forces 0.06 and 0.03 %, tractions 2.0 % of mu p0 at the edge, work 1.5 %.
    """
    coarse, fine = traction_errors(24, 15), traction_errors(48, 31)
    limits = {
        "force at the peak": 0.0012,
        "force without shift": 0.001,
        "traction at the peak": 0.025,
        "traction without shift": 0.025,
        "work": 0.02,
    }
    assert all(fine[name] < limit for name, limit in limits.items()), fine
    assert all(fine[name] < 0.75 * coarse[name] for name in limits), (coarse, fine)


def test_the_middle_sticks_and_the_edges_slip():
    """Stick half-width sqrt(1 - Q / (mu P)), to one strip; what slips has reached the cone."""
    solution, x = rub(48, 31), np.abs(place_pairs(48))
    slip = np.ptp(solution.history("slip", 256), axis=0)
    stick = np.sqrt(1 - PEAK)
    width = 2 * REACH / 48
    inside = slip[x < stick - width]
    assert inside.max() < 1e-3 * slip[(x > stick) & (x < 1)].max()
    assert slip[(x > stick + width) & (x < 1)].min() > 10 * inside.max()


def test_springs_need_fewer_harmonics_than_dashpots():
    """The force on the way down: with springs and N = 5 closer than with dashpots and N = 15."""

    def error(highest: int, closure: str) -> float:
        solution = solve(replace(rub(24, highest).problem, closure=closure))
        force = -solution.history("admissible_friction_force", 4)[1].sum()
        return abs(force / exact_force_without_shift() - 1)

    assert 3 * error(5, "spring") < error(15, "dashpot")
    assert error(31, "spring") < 0.002
