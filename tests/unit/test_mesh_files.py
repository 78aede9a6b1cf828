"""Mesh files of other programs, which list cell by cell what gmsh draws once."""

from __future__ import annotations

from pathlib import Path

import pytest
from mesh_counts import count
from mpi4py import MPI

from ewr_fenicsx.errors import MeshError
from ewr_fenicsx.structure.mesh import build_mesh

# Two squares side by side, of gmsh's types 1 (line) and 3 (quadrilateral); a group's number is that of its entity, too.
NODES = [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)]
GROUPS = {"a": (2, 1), "b": (2, 2), "floor": (1, 3), "left": (1, 4)}
CELLS = [(3, 1, (1, 2, 5, 4)), (3, 2, (2, 3, 6, 5)), (1, 3, (1, 2)), (1, 3, (2, 3)), (1, 4, (4, 1))]


def write_mesh(path: Path, groups: dict, cells: list) -> Path:
    """A file of format 2.2, of cells ``(type, group, nodes)``."""
    sections = {
        "MeshFormat": ["2.2 0 8"],
        "PhysicalNames": [str(len(groups)), *(f'{d} {number} "{name}"' for name, (d, number) in groups.items())],
        "Nodes": [str(len(NODES)), *(f"{k} {x} {y} 0" for k, (x, y) in enumerate(NODES, 1))],
        "Elements": [str(len(cells))]
        + [f"{k} {kind} 2 {g} {g} {' '.join(map(str, nodes))}" for k, (kind, g, nodes) in enumerate(cells, 1)],
    }
    path.write_text("".join(f"${name}\n" + "\n".join(body) + f"\n$End{name}\n" for name, body in sections.items()))
    return path


def read(tmp_path: Path, *further: tuple) -> dict:
    path = write_mesh(tmp_path / "squares.msh", GROUPS | {"top": (1, 5), "spot": (2, 6)}, [*CELLS, *further])
    return count(build_mesh(path, {}, MPI.COMM_WORLD))


def test_a_facet_that_a_boundary_lists_twice_is_one(tmp_path):
    found = read(tmp_path, (1, 3, (2, 1)))
    assert found["bodies"] == {"a": 1, "b": 1} and found["boundaries"] == {"floor": 2, "left": 1}


@pytest.mark.parametrize("facet", [(1, 2), (2, 1)])
def test_a_facet_of_two_boundaries_is_refused(tmp_path, facet):
    """dolfinx left it out of one of them without a word, and the load on that acted on the rest alone."""
    with pytest.raises(MeshError, match='1 facets are in "floor" and in "top"; expected one name for each'):
        read(tmp_path, (1, 5, facet), (1, 5, (4, 5)))


@pytest.mark.parametrize("group", [1, 6])
def test_a_cell_that_is_there_twice_is_refused_before_dolfinx_crashes(tmp_path, group):
    with pytest.raises(MeshError, match=r"1 of 3 cells have the corners of others, as at \(0.5, 0.5, 0\); is a body"):
        read(tmp_path, (3, group, (2, 5, 4, 1)))
