"""Flanks of tetrahedra of second order, whose pairs are in the middle of edges: corners carry no even pressure."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from ewr_fenicsx import load_scene, solve
from ewr_fenicsx.output.output import write_fields
from ewr_fenicsx.output.wear_fields import recede_flanks
from ewr_fenicsx.structure.chain import build_chain, pose_problem

SOURCE = Path(__file__).parents[1] / "geometry" / "tetrahedra.py"
WIDTH, PUSH = 0.02, 400.0
SCENE = """
[geometry]
source = "{source}"
parameters = {{ kind = "{kind}", across = {across}, beside = {beside}, order = {order} }}
[elasticity]
degree = {degree}
[materials.blade]
poisson = {poisson}
[materials.disk]
poisson = {poisson}
[contact]
friction = 0.4
[loads.push]
boundary = "tip"
force = [0.0, {push}, 0.0]
{shake}
[outputs.tip]
boundary = "tip"
direction = [1.0, 0.0, 0.0]
"""
SHAKE = """[loads.shake]
boundary = "tip"
force = [40.0, 0.0, 20.0]
harmonic = 1
[excitation]
frequency = 2000.0
"""


def build(folder, kind="tetrahedra", degree=2, across=3, beside=0, order=1, poisson=0.0, shake=""):
    given = {"kind": kind, "degree": degree, "across": across, "beside": beside, "order": order}
    given |= {"poisson": poisson, "shake": shake}
    path = folder / "scene.toml"
    path.write_text(SCENE.format(source=SOURCE, push=-PUSH, **given))
    scene = load_scene(path)
    chain = build_chain(scene)
    return chain, pose_problem(scene, chain.reduction.model, chain.interface)


def test_an_even_pressure_is_even(tmp_path):
    """Without Poisson's ratio the block is pressed evenly: each pair carries its area's share, exactly."""
    chain, problem = build(tmp_path)
    interface = chain.interface
    assert len(interface.area) == 3 * 3 + 2 * 3 * 4 and interface.area.sum() == pytest.approx(WIDTH**2, rel=1e-12)
    assert sorted(set((interface.area / interface.area.max()).round(9))) == [0.5, 1.0]
    forces = solve(problem).history("normal_force")[0]
    np.testing.assert_allclose(forces, PUSH * interface.area / WIDTH**2, rtol=1e-9)


def test_they_move_as_hexahedra_of_second_order_do(tmp_path):
    """And those of first order do not, by far."""
    found, doubts = {}, {}
    for kind, degree in (("hexahedra", 2), ("tetrahedra", 2), ("tetrahedra", 1)):
        chain, problem = build(tmp_path, kind, degree, 4, 1, poisson=0.3, shake=SHAKE)
        solution = solve(problem)
        assert solution.converged
        doubts[kind, degree] = chain.doubts
        found[kind, degree] = chain.reduction.full_stick.frequency[0], abs(solution.output("tip")[1])
    (first, swing), tetrahedra, stiff = found.values()
    assert not any("tetrahedra" in doubt for key in list(found)[:2] for doubt in doubts[key])
    assert any("tetrahedra of first order are far too stiff" in doubt for doubt in doubts["tetrahedra", 1])
    assert tetrahedra[0] == pytest.approx(first, rel=2e-3)
    assert tetrahedra[1] == pytest.approx(swing, rel=5e-3)
    assert stiff[0] > 1.08 * first and stiff[1] < 0.85 * swing


@pytest.mark.parametrize("order", [1, 2])
def test_fields_have_values_at_corners_too(tmp_path, order):
    """Those of a pair beside them: of an even pressure the same all over the flank, nothing elsewhere."""
    chain, problem = build(tmp_path, order=order)
    write_fields(tmp_path, chain, solve(problem))
    with h5py.File(tmp_path / "contact_pressure.h5") as file:
        (pressure,) = (np.ravel(values) for values in file["Function/contact_pressure"].values())
    flank, even = 16 if order == 1 else 49, PUSH / WIDTH**2
    presses = np.abs(pressure) > 1e-9 * even
    assert np.count_nonzero(presses) == 2 * flank
    np.testing.assert_allclose(pressure[presses], even, rtol=1e-9)
    worn = recede_flanks(chain)(np.full(len(chain.interface.area), 2e-6)).x.array.reshape(-1, 3)
    recedes = np.abs(worn[:, 1]) > 1e-12
    assert np.count_nonzero(recedes) == flank
    np.testing.assert_allclose(worn[recedes], np.tile([0.0, 2e-6, 0.0], (flank, 1)), atol=1e-15)
