"""The scaled Jacobian of cells whose shape is known, and cells that curved sides turn inside out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from ewr_fenicsx.errors import MeshError
from ewr_fenicsx.structure._compat import gmsh_model
from ewr_fenicsx.structure.gmsh_inspection import evaluate_scaled_jacobian, find_folded
from ewr_fenicsx.structure.mesh import build_mesh

BUSH = Path(__file__).parents[1] / "geometry" / "bush.py"


def transform(corners, angle: float = 0.3, size: float = 7.0) -> np.ndarray:
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return (size * np.asarray(corners, dtype=float) @ turn.T + [3.0, -2.0])[None]


@pytest.mark.parametrize(
    "corners, expected",
    [
        ([(0, 0), (1, 0), (1, 1), (0, 1)], 1.0),
        ([(0, 0), (5, 0), (5, 1), (0, 1)], 1.0),
        ([(0, 1), (1, 1), (1, 0), (0, 0)], 1.0),  # numbered clockwise: as good
        ([(0, 0), (1, 0), (1 + 0.5, 3**0.5 / 2), (0.5, 3**0.5 / 2)], 3**0.5 / 2),  # rhombus of 60 degrees
        ([(0, 0), (1, 0), (0.5, 0.5), (0, 1)], 0.0),  # a corner of 180 degrees
        ([(0, 0), (1, 0), (0.25, 0.25), (0, 1)], -0.8),  # a dart: a corner of 180 + 53 degrees
        ([(0, 0), (1, 1), (1, 0), (0, 1)], -(0.5**0.5)),  # crossed
        ([(0, 0), (0, 0), (1, 1), (0, 1)], 0.0),  # two corners in one
    ],
)
def test_scaled_jacobian_of_known_quadrilaterals(corners, expected):
    assert evaluate_scaled_jacobian(transform(corners), "quadrilateral")[0] == pytest.approx(expected, abs=1e-12)


def test_scaled_jacobian_of_ideal_cells_is_one():
    triangle = [(0, 0), (1, 0), (0.5, 3**0.5 / 2)]
    assert evaluate_scaled_jacobian(transform(triangle), "triangle")[0] == pytest.approx(1.0)
    right = [(0, 0), (1, 0), (0, 1)]
    assert evaluate_scaled_jacobian(transform(right), "triangle")[0] == pytest.approx(0.5**0.5 / (3**0.5 / 2))
    tetrahedron = np.array([[(1, 1, 1), (-1, 1, -1), (1, -1, -1), (-1, -1, 1)]], dtype=float)
    assert evaluate_scaled_jacobian(tetrahedron, "tetrahedron")[0] == pytest.approx(1.0)
    hexahedron = np.array(
        [[(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]], dtype=float
    )
    assert evaluate_scaled_jacobian(hexahedron, "hexahedron")[0] == pytest.approx(1.0)


@pytest.mark.parametrize("across", [6, 8, 10])
def test_thin_cells_beside_a_coarse_curve_are_refused_where_it_bulges_through_them(across):
    """A curve of 45 degrees bulges by 2.3 mm of 30 mm, a cell is 10 mm / across thick, and its other side straight."""
    parameters = {"around": 8, "across": across, "order": 2}
    if across < 8:
        assert build_mesh(BUSH, parameters, MPI.COMM_WORLD).smallest_scaled_jacobian > 0.9
    else:
        with pytest.raises(MeshError, match=r'body "blade" has a quadrilateral that its curved sides turn inside out'):
            build_mesh(BUSH, parameters, MPI.COMM_WORLD)


@pytest.mark.parametrize("turn", [1.0, -1.0])
@pytest.mark.parametrize(("first", "second"), [(0.5, 0.5), (0.25, 0.25), (0.2, 0.5), (0.5, 0.9)])
def test_nodes_at_a_quarter_of_the_sides_do_not_fold_a_cell(first, second, turn):
    """As at the tip of a crack, the first corner; numbered either way round."""
    corners = np.array([(0.0, 0.0), (2.0, 0.0), (0.0, turn)])
    sides = [first * corners[1], corners[1:].mean(axis=0), second * corners[2]]
    with gmsh_model("none"):
        assert find_folded(9, np.array([[*corners, *sides]])).tolist() == [first != second]
