"""A gmsh that runs already, as in a notebook: what builders set in it is gone after them."""

from __future__ import annotations

import gmsh
import pytest
from mpi4py import MPI

from ewr_fenicsx.errors import MeshError
from ewr_fenicsx.structure.mesh import build_mesh

DISK = """
import gmsh


def build(*, size: float = 0.0, fails: bool = False) -> None:
    disk = gmsh.model.occ.addDisk(0.0, 0.0, 0.0, 1.0, 1.0)
    gmsh.model.occ.synchronize()
    gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, [disk]), "disk")
    if size:
        gmsh.option.setNumber("Mesh.MeshSizeMax", value=2 * size)
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        gmsh.option.setString("General.AxesLabelX", "length")
        gmsh.option.setColor("Mesh.Points", 1, 2, 3)
    if fails:
        raise ValueError("too thin")
    gmsh.model.mesh.generate(2)
"""


@pytest.mark.parametrize("fails", [False, True])
def test_options_that_a_builder_sets_change_no_mesh_made_after_it(tmp_path, fails):
    path = tmp_path / "disk.py"
    path.write_text(DISK)
    usual = build_mesh(path, {}, MPI.COMM_WORLD).cells
    gmsh.initialize([], False)
    try:
        setter = gmsh.option.setNumber
        gmsh.option.setNumber("Mesh.Smoothing", 3)
        read = lambda: (  # noqa: E731
            gmsh.option.getNumber("Mesh.Smoothing"),
            gmsh.option.getNumber("Mesh.MeshSizeMax"),
            gmsh.option.getString("General.AxesLabelX"),
            gmsh.option.getColor("Mesh.Points"),
        )
        before = read()
        if fails:
            with pytest.raises(MeshError, match="too thin"):
                build_mesh(path, {"size": 0.1, "fails": True}, MPI.COMM_WORLD)
        else:
            assert build_mesh(path, {"size": 0.1}, MPI.COMM_WORLD).cells > 2 * usual
        assert read() == before and gmsh.option.setNumber is setter
        assert build_mesh(path, {}, MPI.COMM_WORLD).cells == usual
    finally:
        gmsh.option.setNumber("General.Terminal", 0)  # a stopped gmsh 4.8 would go on printing
        gmsh.finalize()
