"""The scaled Jacobian of cells whose shape is known."""

from __future__ import annotations

import numpy as np
import pytest

from ewr_fenicsx.structure.gmsh_inspection import evaluate_scaled_jacobian


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
