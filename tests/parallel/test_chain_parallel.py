"""The chain from mesh to reduced model gives the same figures on one rank and on two."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from small_scenes import AT, PULL, SHAKE, write_blocks

from ewr_fenicsx.model.cyclic_symmetry import COUPLINGS
from ewr_fenicsx.model.reduced_model import read_reduced_model

SCRIPT = Path(__file__).with_name("chain_on_ranks.py")
TWO_BLOCKS = Path(__file__).parents[1] / "geometry" / "two_blocks.py"
CORNERED, BUSH = TWO_BLOCKS.with_name("cornered.py"), TWO_BLOCKS.with_name("bush.py")
ROOT = Path(__file__).parents[2]
FIR_TREE, EXTRUDED = ROOT / "geometry" / "fir_tree.py", ROOT / "geometry" / "extruded.py"


def run_chain(mpirun, tmp_path, ranks, source, parameters, degree):
    target = tmp_path / f"{ranks}.npz"
    finished = mpirun(
        ranks, "python", "-m", "mpi4py", SCRIPT, source, json.dumps(parameters), str(degree), target, timeout=120.0
    )
    assert finished.returncode == 0, finished.stderr + finished.stdout
    with np.load(target) as figures:
        return dict(figures)


# blocks of as many cells each: the partitioner then cuts along the joint
@pytest.mark.parametrize(
    "source, parameters, degree",
    [
        (TWO_BLOCKS, {"disk_rows": 8}, 1),
        (TWO_BLOCKS, {"disk_rows": 8}, 2),
        (FIR_TREE, {}, 1),
    ],
)
def test_one_and_two_ranks_agree(mpirun, tmp_path, source, parameters, degree):
    """Pairs, areas, modes, matrices and an expanded field to 1e-9, compliance to rounding; all ranks hold the same."""
    one, two = (run_chain(mpirun, tmp_path, ranks, source, parameters, degree) for ranks in (1, 2))
    if source == TWO_BLOCKS:
        assert two["bodies_on_rank"].sum(axis=1).tolist() == [1, 1], "each body should live on a rank of its own"
    np.testing.assert_array_equal(one["cells"], two["cells"])
    assert two["pairs_agree"] and two["models_agree"]
    for name in ("position", "area", "normal", "fixed", "stick", "tip", "energy"):
        np.testing.assert_allclose(two[name], one[name], rtol=1e-9, atol=1e-12 * np.abs(one[name]).max(), err_msg=name)
    for name in ("stiffness", "mass"):
        scale = np.abs(one[name]).max()
        np.testing.assert_allclose(two[name], one[name], rtol=0, atol=1e-9 * scale, err_msg=name)
    # at 300 Hz a free body moves almost rigidly: what rounding leaves of its large stiffness, summed in another order,
    # counts against a small inertia (6e-10 to 1.1e-9 seen); at 1500 and 4000 Hz ranks agree a thousand times better
    scale = np.abs(one["compliance"]).max()
    for k, tolerance in enumerate((1e-8, 1e-10, 1e-10)):
        difference = np.abs(two["compliance"][k] - one["compliance"][k]).max()
        assert difference <= tolerance * scale, (k, difference / scale)
    for figures in (one, two):
        assert figures["energy"] == pytest.approx(figures["work"], rel=1e-9)
        assert (figures["rigid"] < 1e-12).all()


def test_a_corner_is_seen_on_any_number_of_ranks(mpirun, tmp_path):
    """Also where its two edges lie on different ranks."""
    script = tmp_path / "script.py"
    script.write_text(
        "import sys\n"
        "from pathlib import Path\n"
        "from mpi4py import MPI\n"
        "from ewr_fenicsx.structure.elasticity import assemble_structure\n"
        "from ewr_fenicsx.errors import InterfaceError\n"
        "from ewr_fenicsx.structure.interface import pair_interface\n"
        "from ewr_fenicsx.structure.materials import TITANIUM\n"
        "from ewr_fenicsx.structure.mesh import build_mesh\n"
        "mesh = build_mesh(Path(sys.argv[1]), {}, MPI.COMM_WORLD)\n"
        "structure = assemble_structure(mesh, materials=dict.fromkeys(mesh.bodies, TITANIUM))\n"
        "try:\n"
        "    pair_interface(structure)\n"
        "except InterfaceError as error:\n"
        "    told = MPI.COMM_WORLD.gather(str(error))\n"
        "    print(*(told or []), sep='\\n', flush=True)\n"
    )
    for ranks in (1, 3):
        done = mpirun(ranks, "python", "-m", "mpi4py", script, CORNERED)
        told = [line for line in done.stdout.splitlines() if line.startswith('flank "seat" turns a corner of 90 deg')]
        assert len(told) == ranks and len(set(told)) == 1, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("source", "parameters", "degree"),
    [
        (BUSH, {"order": 2, "quarters": 2, "grading": 1.2}, 2),
        (EXTRUDED, {"profile": str(BUSH), "depth": 0.01, "layers": 2, "quarters": 2, "grading": 1.2}, 1),
        (EXTRUDED, {"profile": str(BUSH), "depth": 0.01, "layers": 2, "quarters": 2, "grading": 1.2}, 2),
    ],
)
def test_round_flanks_have_the_normals_of_their_circle_on_any_number_of_ranks(
    mpirun, tmp_path, source, parameters, degree
):
    """Also where neighbouring faces, whose nodes a circle goes through, lie on different ranks."""
    script = tmp_path / "script.py"
    script.write_text(
        "import json, sys\n"
        "from pathlib import Path\n"
        "import numpy as np\n"
        "from mpi4py import MPI\n"
        "from ewr_fenicsx.structure.boundaries import boundary_facets\n"
        "from ewr_fenicsx.structure.elasticity import assemble_structure\n"
        "from ewr_fenicsx.structure.interface import pair_interface\n"
        "from ewr_fenicsx.structure.materials import TITANIUM\n"
        "from ewr_fenicsx.structure.mesh import build_mesh\n"
        "comm = MPI.COMM_WORLD\n"
        "mesh = build_mesh(Path(sys.argv[1]), json.loads(sys.argv[2]), comm)\n"
        "materials = dict.fromkeys(mesh.bodies, TITANIUM)\n"
        "structure = assemble_structure(mesh, materials=materials, degree=int(sys.argv[3]))\n"
        "pairs = pair_interface(structure, ['joint'])\n"
        "radial = pairs.position.copy()\n"
        "radial[:, 2:] = 0.0\n"
        "radial /= np.linalg.norm(radial, axis=1, keepdims=True)\n"
        "parts = comm.allgather(len(boundary_facets(mesh, 'joint')))\n"
        "assert min(parts) > 0, parts\n"
        "told = comm.gather(f'{len(pairs.area)} pairs, round: {np.abs(pairs.normal - radial).max() < 1e-9}')\n"
        "if told:\n"
        "    print(*told, sep='\\n', flush=True)\n"
    )
    count = (8 * degree + 1) * (2 * degree + 1 if source == EXTRUDED else 1)
    for ranks in (2, 3):
        done = mpirun(ranks, "python", "-m", "mpi4py", script, source, json.dumps(parameters), str(degree))
        assert done.stdout.splitlines() == [f"{count} pairs, round: True"] * ranks, done.stdout + done.stderr


def test_ranks_tell_of_a_third_body_and_of_the_thinnest_as_one(mpirun, tmp_path):
    script, scene = tmp_path / "script.py", tmp_path / "scene.toml"
    scene.write_text(write_blocks(source=TWO_BLOCKS.with_name("pile.py")))
    script.write_text(
        "import sys\n"
        "from mpi4py import MPI\n"
        "from ewr_fenicsx import load_scene\n"
        "from ewr_fenicsx.structure.chain import build_chain\n"
        "from ewr_fenicsx.output.gathering import measure_thinnest_body\n"
        "chain = build_chain(load_scene(sys.argv[1], warn=False), MPI.COMM_WORLD)\n"
        "told = MPI.COMM_WORLD.gather(f'{measure_thinnest_body(chain):.9f} {chain.doubts}')\n"
        "print(*(told or []), sep='\\n', flush=True)\n"
    )
    done = mpirun(3, "python", "-m", "mpi4py", script, scene)
    told = [line for line in done.stdout.splitlines() if line.startswith('0.020000000 (\'boundary "lid" lies on')]
    assert len(told) == 3 and len(set(told)) == 1, done.stdout + done.stderr


def test_error_on_two_ranks_stops_both(mpirun, tmp_path):
    """A joint that cannot be paired is refused on every rank, in time, with the flank's name."""
    builder = tmp_path / "apart.py"
    builder.write_text(TWO_BLOCKS.read_text().replace("shift: float = 0.0", "shift: float = 1e-5"))
    finished = mpirun(2, "python", "-m", "mpi4py", SCRIPT, builder, "{}", "1", tmp_path / "none.npz", timeout=60.0)
    assert finished.returncode != 0
    assert 'InterfaceError: flank "joint"' in finished.stderr
    assert not (tmp_path / "none.npz").exists()


def save_models(mpirun, tmp_path, scene, ranks):
    (tmp_path / "script.py").write_text(
        "import sys\n"
        "from mpi4py import MPI\n"
        "from ewr_fenicsx import load_scene\n"
        "from ewr_fenicsx.structure.chain import build_chain\n"
        "model = build_chain(load_scene(sys.argv[1]), MPI.COMM_WORLD).reduction.model\n"
        "if MPI.COMM_WORLD.rank == 0:\n"
        "    model.save(sys.argv[2])\n"
    )
    for count in ranks:
        target = tmp_path / f"{count}.h5"
        done = mpirun(count, "python", "-m", "mpi4py", "script.py", scene, target)
        assert done.returncode == 0, done.stderr
        yield read_reduced_model(target)


def test_bodies_that_are_alike_have_the_same_model_on_any_number_of_ranks(mpirun, tmp_path):
    """Their modes come in pairs of one frequency, which rounding mixes: work could not be gone on with, not even on as
    many ranks as it was begun on."""
    one, two = save_models(mpirun, tmp_path, ROOT / "demos" / "bolted_lap.toml", (1, 2))
    for a, b in ((one.mass, two.mass), (one.damping, two.damping), (one.load[1], two.load[1])):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-9 * np.abs(a).max())


def test_a_sector_of_a_ring_has_the_same_model_on_any_number_of_ranks(mpirun, tmp_path):
    """Whatever ranks its cuts are on, and in whatever order they number them."""
    (tmp_path / "sector.toml").write_text(
        f"[geometry]\nsource = '{FIR_TREE}'\nparameters = {{ free_cuts = true }}\n"
        "[cyclic]\nsectors = 30\nengine_order = 4\nlow = 'low_cut'\nhigh = 'high_cut'\n" + PULL + SHAKE + AT
    )
    compare_rings(*save_models(mpirun, tmp_path, tmp_path / "sector.toml", (1, 3)))


def test_sectors_that_touch_have_the_same_model_on_any_number_of_ranks(mpirun, tmp_path):
    """The wedge of a sector, and the blade of the next one, may lie on different ranks."""
    compare_rings(*save_models(mpirun, tmp_path, ROOT / "demos" / "damped_ring.toml", (1, 2)))


def compare_rings(one, other):
    """Matrices, loads and contact rows of a sector, and what joins it to the next one."""
    assert one.cyclic.arrays.keys() == other.cyclic.arrays.keys()
    pairs = [(one.load[1], other.load[1])]
    pairs += [(getattr(one, name), getattr(other, name)) for name in COUPLINGS]
    pairs += [(getattr(one.cyclic, name), getattr(other.cyclic, name)) for name in COUPLINGS]
    pairs += [(one.rows(direction, 1), other.rows(direction, 1)) for direction in ("normal", "tangential")]
    for a, b in pairs:
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-9 * np.abs(a).max())
