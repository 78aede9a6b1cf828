"""A hub shrunk onto a ring that turns: the pressure of their interference, and the speed at which it is lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ewr_fenicsx import PeriodicSolution, load_scene, solve
from ewr_fenicsx.structure.chain import build_chain, pose_problem

pytestmark = pytest.mark.filterwarnings("ignore:.*no load oscillates")

BUSH = Path(__file__).parents[1] / "geometry" / "bush.py"
BORE, FIT, RIM = 0.02, 0.03, 0.05  # radii [m]: where the ring is held, where the hub sits on it, where that ends
YOUNG, POISSON, DENSITY, INTERFERENCE = 200e9, 0.3, 7850.0, 10e-6  # Pa, -, kg/m^3, m
SCENE = """
[geometry]
source = "{source}"
parameters = {{ around = {around}, across = {across} }}
[materials]
blade = {steel}
disk = {steel}
[elasticity]
plane = "stress"
[supports]
clamp = ["tip"]
[contact]
flanks = ["joint"]
initial_gap = {gap}
[loads.spin]
kind = "rotation"
speed = {rpm}
centre = [0.0, 0.0]
"""
STEEL = f"{{ young = {YOUNG}, poisson = {POISSON}, density = {DENSITY} }}"


def find_pressure(speed: float) -> float:
    """Of the hub on the ring [Pa] at a speed [rad/s], in plane stress: negative where it would have to pull.

    Radial motions are ``A r + B / r - (1 - nu^2) rho speed^2 r^3 / (8 E)``, with ``A`` and ``B`` of each body such that
    the bore is at rest, the rim is free, and at the fit the pressure is one and the hub goes out by the interference
    more than the ring.

    Source: Timoshenko and Goodier (1970), Theory of Elasticity, articles 28 and 32.
    """
    spun = DENSITY * speed**2 * (1 - POISSON**2) / (8 * YOUNG)
    moved = lambda r: np.array([r, 1 / r])  # noqa: E731  by A and B
    stressed = lambda r: YOUNG / (1 - POISSON**2) * np.array([1 + POISSON, -(1 - POISSON) / r**2])  # noqa: E731
    pulled = lambda r: (3 + POISSON) / 8 * DENSITY * speed**2 * r**2  # noqa: E731  less, by spinning
    none = np.zeros(2)
    matrix = [
        [*moved(BORE), *none],
        [*none, *stressed(RIM)],
        [*stressed(FIT), *-stressed(FIT)],
        [*-moved(FIT), *moved(FIT)],
    ]
    a, b, *_ = np.linalg.solve(matrix, [spun * BORE**3, pulled(RIM), 0.0, INTERFERENCE])
    return float(pulled(FIT) - stressed(FIT) @ [a, b])


def find_loosening_speed() -> float:
    """Where the pressure, which falls with the square of the speed, is gone [rad/s]."""
    return float(np.sqrt(find_pressure(0.0) / (find_pressure(0.0) - find_pressure(1.0))))


def fit(folder: Path, speed: float, around: int, across: int) -> PeriodicSolution:
    """The joint at a speed [rad/s]."""
    path = folder / "fit.toml"
    rpm = speed * 60 / (2 * np.pi)
    text = SCENE.format(source=BUSH, around=around, across=across, steel=STEEL, gap=-INTERFERENCE, rpm=rpm)
    path.write_text(text, encoding="utf-8")
    chain = build_chain(load_scene(path))
    return solve(pose_problem(chain.scene, chain.reduction.model), tolerance=1e-10)


def measure_pressure(solution: PeriodicSolution) -> tuple[float, float]:
    """Mean [Pa], and how far pairs are from it, over it."""
    pressure = solution.pair_forces["normal"][0].real / solution.problem.model.areas
    return float(pressure.mean()), float(np.abs(pressure / pressure.mean() - 1).max())


@pytest.mark.parametrize("share", [1e-3, 0.5, 0.9])
def test_pressure_of_a_shrink_fit_that_turns(share, tmp_path):
    """Of the speed at which it is lost. The mesh's error falls fourfold with twice the elements."""
    speed = share * find_loosening_speed()
    errors = []
    for around, across in ((24, 4), (48, 8)):
        pressure, spread = measure_pressure(fit(tmp_path, speed, around, across))
        assert spread < 1e-3
        errors.append(abs(pressure - find_pressure(speed)) / find_pressure(0.0))
    assert errors[1] < 0.3 * errors[0] and errors[1] < 5e-3, errors


def test_a_shrink_fit_is_lost_at_its_loosening_speed(tmp_path):
    speed = find_loosening_speed()
    assert find_pressure(speed) == pytest.approx(0.0, abs=1e-9 * find_pressure(0.0))
    held, lost = (fit(tmp_path, share * speed, 48, 8) for share in (0.98, 1.02))
    assert held.pair_forces["normal"][0].real.min() > 0.0 and held.history("gap").max() < 1e-12
    assert np.abs(lost.pair_forces["normal"]).max() < 1e-6 * held.pair_forces["normal"].real.max()
    assert lost.history("gap").min() > 0.0
