"""Meshes under ``mpirun``: the same on two ranks, and what is wrong with one is told on both."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from mesh_counts import count
from mpi4py import MPI
from small_scenes import SCENE, write_blocks

from ewr_fenicsx.structure.mesh import build_mesh

TESTS = Path(__file__).parents[1]
GEOMETRY = TESTS.parent / "geometry"
pytestmark = pytest.mark.parallel

COUNT = """
import json, sys
from pathlib import Path
from mpi4py import MPI
sys.path.insert(0, {tests!r})
from mesh_counts import count
from ewr_fenicsx.structure.mesh import build_mesh
mesh = build_mesh(Path({source!r}), {parameters!r}, MPI.COMM_WORLD)
found = MPI.COMM_WORLD.gather([count(mesh), dict(mesh.bodies), dict(mesh.boundaries), mesh.smallest_scaled_jacobian])
if found:
    assert all(one == found[0] for one in found), found
    print("FOUND", json.dumps(found[0]))
"""


@pytest.mark.parametrize("name", ["fir_tree.py", "dovetail.py", "extruded.py"])
def test_two_ranks_give_the_same_mesh(mpirun, tmp_path, name):
    script = tmp_path / "count.py"
    script.write_text(COUNT.format(tests=str(TESTS), source=str(GEOMETRY / name), parameters={}))
    run = mpirun(2, "python", "-m", "mpi4py", script)
    assert run.returncode == 0, run.stderr
    (line,) = [line for line in run.stdout.splitlines() if line.startswith("FOUND")]
    mesh = build_mesh(GEOMETRY / name, {}, MPI.COMM_SELF)
    assert json.loads(line.removeprefix("FOUND")) == [
        count(mesh),
        mesh.bodies,
        mesh.boundaries,
        mesh.smallest_scaled_jacobian,
    ]


def test_pieces_that_share_a_corner_alone_do_not_come_apart(mpirun, tmp_path):
    """dolfinx gives each rank a node of its own there; each piece held, nothing else would tell."""
    (tmp_path / "pieces.py").write_text("""
import gmsh

def build():
    geo, corner, pieces, ends = gmsh.model.geo, gmsh.model.geo.addPoint(0.0, 0.0, 0.0), [], []
    for side in (-0.01, 0.01):
        points = [corner, *(geo.addPoint(side * x, side * y, 0.0) for x, y in ((1, 0), (1, 1), (0, 1)))]
        lines = [geo.addLine(points[k - 1], points[k]) for k in range(4)]
        pieces.append(geo.addPlaneSurface([geo.addCurveLoop(lines)]))
        ends.append(lines[2])
    geo.synchronize()
    gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, pieces), "blade")
    gmsh.model.setPhysicalName(1, gmsh.model.addPhysicalGroup(1, ends), "clamp")
    gmsh.model.mesh.generate(2)
""")
    (tmp_path / "scene.toml").write_text(SCENE.replace("builder.py", "pieces.py"))
    run = mpirun(2, "ewr", "info", "scene.toml", timeout=60.0)
    assert run.returncode == 2, run.stderr
    assert run.stderr.count("pieces.py: on 2 ranks the mesh comes apart, with more nodes than it has, by 1") == 1


def test_an_error_on_rank_0_is_raised_on_both(mpirun, tmp_path):
    script = tmp_path / "fail.py"
    script.write_text(f"""
import json
from pathlib import Path
from mpi4py import MPI
from ewr_fenicsx.errors import MeshError
from ewr_fenicsx.structure.mesh import build_mesh
try:
    build_mesh(Path({str(GEOMETRY / "fir_tree.py")!r}), {{"lobe": 2}}, MPI.COMM_WORLD)
except MeshError as error:
    messages = MPI.COMM_WORLD.gather(str(error))  # two ranks that print might do so within one line
    if messages:
        Path("messages.json").write_text(json.dumps(messages))
""")
    run = mpirun(2, "python", script, timeout=60.0)
    assert run.returncode == 0, run.stderr
    messages = json.loads((tmp_path / "messages.json").read_text())
    assert len(messages) == 2
    assert all(message.endswith('unknown parameter "lobe" = 2; did you mean "lobes"?') for message in messages)


def test_a_builder_that_leaves_stops_both(mpirun, tmp_path):
    """gmsh runs on rank 0 alone: were it gone, the other would wait for ever."""
    (tmp_path / "leaving.py").write_text("import sys\n\n\ndef build():\n    sys.exit('no licence')\n")
    (tmp_path / "scene.toml").write_text(SCENE.replace("builder.py", "leaving.py"))
    run = mpirun(2, "ewr", "info", "scene.toml", timeout=60.0)
    assert run.returncode == 2, run.stderr
    assert run.stderr.count("leaving.py: SystemExit: no licence") == 1


def test_a_load_on_a_flank_is_refused_on_both(mpirun, tmp_path):
    """Each rank sees a part of the flank, or none."""
    (tmp_path / "scene.toml").write_text(write_blocks().replace('boundary = "tip"', 'boundary = "joint"', 1))
    run = mpirun(2, "ewr", "info", "scene.toml", timeout=60.0)
    assert run.returncode == 2, run.stderr
    assert run.stderr.count('loads.push.boundary = "joint" is a flank') == 1


def test_a_mesh_too_small_for_its_ranks_is_refused(mpirun, tmp_path):
    """Four cells on five ranks: PETSc crashes on a rank without any."""
    (tmp_path / "scene.toml").write_text(write_blocks(parameters="columns = 2, blade_rows = 1, disk_rows = 1"))
    run = mpirun(5, "ewr", "info", "scene.toml", timeout=60.0)
    assert run.returncode == 2, run.stderr
    assert run.stderr.count("4 cells leave one of 5 ranks with none; take fewer ranks") == 1
