"""Matrices, loads and output rows against integrals known in closed form; names and values that are refused."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from math import pi
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from ewr_fenicsx.errors import EwrError, MeshError, SceneError
from ewr_fenicsx.structure import _compat
from ewr_fenicsx.structure.elasticity import BoundaryForce, CentrifugalForce, OutputSpec, assemble_structure, body_nodes
from ewr_fenicsx.structure.materials import TITANIUM, Material, PerMode, Rayleigh, RayleighRatios
from ewr_fenicsx.structure.mesh import build_mesh

TWO_BLOCKS = Path(__file__).parents[1] / "geometry" / "two_blocks.py"
FLUSH_BLOCKS = TWO_BLOCKS.with_name("flush_blocks.py")
BOTH = {"blade": TITANIUM, "disk": TITANIUM}


@pytest.fixture(scope="module")
def mesh():
    return build_mesh(TWO_BLOCKS, {"skew": 0.01}, MPI.COMM_WORLD)


def coordinates(structure):
    return structure.space.tabulate_dof_coordinates()[:, :2]


def as_vector(structure, field):
    """The nodal vector of a displacement field given as a function of x and y."""
    vector = structure.mass.createVecRight()
    vector.array[:] = np.column_stack(field(*coordinates(structure).T)).ravel()
    return vector


@pytest.mark.parametrize("degree", [1, 2])
def test_mass_is_density_times_volume(mesh, degree):
    """A unit translation has the kinetic energy of each body's mass; the bodies have their own densities."""
    heavy = Material(TITANIUM.young, TITANIUM.poisson, 8000.0)
    structure = assemble_structure(mesh, materials={"blade": TITANIUM, "disk": heavy}, thickness=0.02, degree=degree)
    unit = as_vector(structure, lambda x, y: (1 + 0 * x, 0 * x))
    expected = 0.02 * (4430.0 * 0.04 * 0.06 + 8000.0 * 0.04 * 0.03)
    assert unit.dot(structure.mass * unit) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("degree", [1, 2])
def test_mass_of_linear_motion_is_exact_on_skewed_elements(mesh, degree):
    """int rho t x^2 over the blade, for the field u = x that both degrees hold exactly."""
    structure = assemble_structure(mesh, materials=BOTH, thickness=0.02, degree=degree)
    stretch = structure.mass.createVecRight()
    nodes = body_nodes(structure, "blade")
    stretch.array[2 * nodes] = coordinates(structure)[nodes, 0]
    # the blade is a parallelogram: x = x0 + s, s from 0 to 0.04, x0 from 0 to 0.01
    mean_square = 0.04**2 / 3 + 2 * 0.02 * 0.005 + 0.01**2 / 3
    assert stretch.dot(structure.mass * stretch) == pytest.approx(4430 * 0.02 * 0.04 * 0.06 * mean_square, rel=1e-12)


@pytest.mark.parametrize("degree", [1, 2])
def test_edge_force_has_its_resultant_and_no_moment_about_the_middle(mesh, degree):
    """F_x and F_y sum to the force given; spread evenly, its moment acts at the middle of the edge."""
    structure = assemble_structure(
        mesh, materials=BOTH, degree=degree, loads=[BoundaryForce("f", "tip", (3.0, -7.0), 2, 0.5)]
    )
    (load,) = structure.loads
    force = load.vector.array.reshape(-1, 2)
    x, y = coordinates(structure).T
    np.testing.assert_allclose(force.sum(axis=0), (3.0, -7.0), rtol=1e-12)
    moment = x @ force[:, 1] - y @ force[:, 0]
    assert moment == pytest.approx((0.01 + 0.02) * -7.0 - 0.09 * 3.0, rel=1e-12)
    assert (load.name, load.harmonic) == ("f", 2)
    assert load.amplitude == pytest.approx(np.exp(0.5j))


@pytest.mark.parametrize(
    "body, mass, middle", [("blade", 0.04 * 0.06, (0.025, 0.06)), ("disk", 0.04 * 0.03, (0.02, 0.015))]
)
def test_centrifugal_force_is_mass_times_acceleration_of_the_mass_centre(mesh, body, mass, middle):
    """int rho omega^2 (x - c) dV = m omega^2 (x_s - c), body by body."""
    structure = assemble_structure(
        mesh,
        materials=BOTH,
        thickness=0.02,
        loads=[CentrifugalForce("spin", 300.0, (0.01, -0.2))],
    )
    forces = structure.loads[0].vector.array.reshape(-1, 2)
    expected = 4430 * 0.02 * mass * 300.0**2 * (np.array(middle) - (0.01, -0.2))
    np.testing.assert_allclose(forces[body_nodes(structure, body)].sum(axis=0), expected, rtol=1e-12)
    assert structure.loads[0].harmonic == 0


def test_output_row_is_the_mean_displacement_along_its_unit_direction(mesh):
    structure = assemble_structure(mesh, materials=BOTH, outputs=[OutputSpec("tip", "tip", (3.0, 4.0))])
    motion = as_vector(structure, lambda x, y: (1.0 + 2 * x, 5.0 - x + y))
    x, y = 0.03, 0.09
    assert structure.outputs["tip"].dot(motion) == pytest.approx(0.6 * (1 + 2 * x) + 0.8 * (5 - x + y), rel=1e-12)


def test_clamp_lists_both_directions_of_its_nodes(mesh):
    structure = assemble_structure(mesh, materials=BOTH, degree=2)
    dofs = structure.fixed_dofs
    assert len(dofs) == 2 * 13
    np.testing.assert_allclose(coordinates(structure)[dofs // 2, 1], 0, atol=1e-12)
    np.testing.assert_array_equal(structure.fixed, dofs)  # of the only rank
    assert assemble_structure(mesh, materials=BOTH, clamp=()).fixed_dofs.size == 0


def test_modal_ratios_give_the_ratios_back():
    """zeta(omega) = alpha / (2 omega) + beta omega / 2 at both frequencies."""
    damping = RayleighRatios((500.0, 3000.0), (0.002, 0.003)).rayleigh()
    for frequency, ratio in ((500.0, 0.002), (3000.0, 0.003)):
        omega = 2 * pi * frequency
        assert damping.alpha / (2 * omega) + damping.beta * omega / 2 == pytest.approx(ratio, rel=1e-12)


@pytest.mark.parametrize("ratios, zero", [((0.002, 0.004), "alpha"), ((0.004, 0.002), "beta")])
def test_modal_ratios_at_the_edge_leave_one_coefficient_zero(ratios, zero):
    """Stiffness-proportional: ratios grow like the frequency; mass-proportional: they fall like it."""
    assert getattr(RayleighRatios((500.0, 1000.0), ratios).rayleigh(), zero) == 0.0


@pytest.mark.parametrize("ratios", [(0.001, 0.02), (0.02, 0.001)])
def test_modal_ratios_that_need_negative_damping_are_refused(ratios):
    with pytest.raises(SceneError, match=r"must lie between 0\.5 and 2"):
        RayleighRatios((500.0, 1000.0), ratios).rayleigh()


def test_rayleigh_damping_matrix(mesh):
    structure = assemble_structure(mesh, materials=BOTH, damping=Rayleigh(3.0, 2e-6))
    expected = 3.0 * structure.mass + 2e-6 * structure.stiffness
    assert (structure.damping - expected).norm() <= 1e-14 * expected.norm()
    assert structure.modal_damping is None
    modal = assemble_structure(mesh, materials=BOTH, damping=PerMode(0.01))
    assert modal.damping.norm() == 0 and modal.modal_damping == 0.01


@pytest.mark.parametrize(
    "change, error, words",
    [
        ({"clamp": ("clmp",)}, MeshError, 'no boundary named "clmp".*did you mean "clamp"'),
        ({"loads": [BoundaryForce("f", "tipp", (1.0, 0.0))]}, MeshError, 'did you mean "tip"'),
        ({"loads": [BoundaryForce("f", "TIP", (1.0, 0.0))]}, MeshError, 'did you mean "tip"'),
        ({"materials": {"blade": TITANIUM, "dsk": TITANIUM}}, MeshError, 'did you mean "disk"'),
        ({"materials": {"blade": TITANIUM}}, SceneError, 'body "disk" has none'),
        ({"thickness": 0.0}, SceneError, "thickness is 0.0 m"),
        ({"plane": "stres"}, SceneError, 'did you mean "stress"'),
        ({"degree": 3}, SceneError, "degree is 3"),
        ({"outputs": [OutputSpec("tip", "tip", (0.0, 0.0))]}, SceneError, 'output "tip": direction'),
    ],
)
def test_bad_values_are_named(mesh, change, error, words):
    with pytest.raises(error, match=words):
        assemble_structure(mesh, **({"materials": BOTH} | change))


@pytest.mark.parametrize(
    "entry",
    [{"loads": [BoundaryForce("pull", "joint", (1.0, 0.0))]}, {"outputs": [OutputSpec("mid", "joint", (1.0, 0.0))]}],
)
def test_a_load_or_output_inside_a_body_is_refused(entry):
    """The joint of welded blocks has cells on either side, and no edge integral sees it."""
    welded = build_mesh(TWO_BLOCKS, {"welded": True, "columns": 4}, MPI.COMM_WORLD)
    with pytest.raises(MeshError, match='boundary "joint": 4 of its 4 facets lie inside'):
        assemble_structure(welded, materials=BOTH, **entry)


@pytest.mark.parametrize("shift", [0.0, 1e-4])
@pytest.mark.parametrize(
    "entry, words",
    [
        ({"loads": [BoundaryForce("press", "joint", (0.0, -1.0))]}, "loads.press.*carry a part of the load"),
        ({"outputs": [OutputSpec("mid", "joint", (1.0, 0.0))]}, "outputs.mid.*be the mean over both"),
    ],
)
def test_a_load_or_output_on_a_flank_is_refused(entry, words, shift):
    """It would be spread over both bodies, or be their mean, without a word; also where the mesh has a gap."""
    apart = build_mesh(TWO_BLOCKS, {"shift": shift}, MPI.COMM_WORLD)
    with pytest.raises(MeshError, match=words) as told:
        assemble_structure(apart, materials=BOTH, **entry)
    assert 'boundary = "joint" is a flank: it lies on both bodies, ' in str(told.value)
    assert "blade" in str(told.value) and "disk" in str(told.value)
    assert str(told.value).endswith("name a boundary of one body")


@pytest.mark.parametrize("boundary", ["sides", "ends"])
def test_a_boundary_with_curves_of_several_bodies_that_do_not_meet_carries_a_load(boundary):
    """One straight side of both blocks, across the joint; and their far ends, which look away from each other."""
    mesh = build_mesh(FLUSH_BLOCKS, {}, MPI.COMM_WORLD)
    load = BoundaryForce("press", boundary, (3.0, -4.0))
    structure = assemble_structure(mesh, materials=BOTH, loads=[load], outputs=[OutputSpec("mid", boundary, (1, 0))])
    np.testing.assert_allclose(structure.loads[0].vector.array.reshape(-1, 2).sum(axis=0), load.force)


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda: Material(-1.0, 0.3, 1.0), "young is -1.0"),
        (lambda: Material(1.0, 0.5, 1.0), "poisson is 0.5"),
        (lambda: Material(1.0, 0.3, float("nan")), "density is nan"),
        (lambda: Rayleigh(-1.0), "alpha = -1.0"),
        (lambda: PerMode(1.5), "1.5"),
        (lambda: BoundaryForce("f", "tip", (1, 0), 0, 0.3), "static load has no phase"),
        (lambda: BoundaryForce("f", "tip", (1, 0), -1), "harmonic is -1"),
        (lambda: RayleighRatios((500.0, 500.0), (0.1, 0.1)).rayleigh(), "two different"),
    ],
)
def test_descriptions_refuse_values_out_of_range(make, words):
    with pytest.raises(SceneError, match=words):
        make()


def test_interrupted_compilation_says_how_to_clear_the_cache():
    expected = r"the mass form: TimeoutError.*timed out[\s\S]*rm -r .*fenics"
    with pytest.raises(EwrError, match=expected), _compat.compiling("the mass form"):
        raise TimeoutError("JIT compilation timed out")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_compilation_is_finished_before_an_interruption_is_heeded(number):
    """The next run would wait for the end of an unfinished one."""
    heeded, finished = [], []
    usual = signal.signal(number, lambda *_: heeded.append(number))
    try:
        with _compat.compiling("a form"):
            signal.raise_signal(number)
            finished.append(not heeded)
    finally:
        signal.signal(number, usual)
    assert finished == [True] and heeded == [number]


def compile_elsewhere(tmp_path: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Compiles a form in a new process with an empty cache."""
    program = (
        "import dolfinx, logging, ufl\nfrom mpi4py import MPI\nfrom ewr_fenicsx.structure import _compat\n"
        "mesh = dolfinx.mesh.create_unit_square(MPI.COMM_SELF, 1, 1)\n"
        "v = ufl.TestFunction(_compat.function_space(mesh, 'Lagrange', 1))\n"
        "_compat.compile_form(v * ufl.dx, 'a form')\nlogging.warning('heard')\n"
    )
    return subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env=os.environ | {"XDG_CACHE_HOME": str(tmp_path)} | environment,
    )


def test_compiler_chatter_is_silent(tmp_path):
    """gcc's INFO lines are kept from stderr; warnings of others are still heard afterwards."""
    finished = compile_elsewhere(tmp_path)
    assert finished.returncode == 0, finished.stderr
    assert finished.stderr.strip() == "WARNING:root:heard"
    assert list(tmp_path.rglob("*.c.cached"))


def test_missing_compiler_is_one_clear_error(tmp_path):
    finished = compile_elsewhere(tmp_path, CC="/nonexistent/cc")
    assert finished.returncode == 1
    assert "EwrError: cannot compile" in finished.stderr and "apt-get install gcc" in finished.stderr
    assert str(tmp_path) in finished.stderr


def test_a_cache_that_cannot_be_written_is_one_clear_error(tmp_path):
    finished = compile_elsewhere(tmp_path, XDG_CACHE_HOME="/proc/ewr")  # even root cannot write there
    assert finished.returncode == 1
    assert "The cache is /proc/ewr/fenics; if it cannot be written, set XDG_CACHE_HOME" in finished.stderr


def test_a_cache_on_a_full_disk_is_no_missing_compiler():
    told = r"No space left on device\nThe cache is .*; if it cannot be written, set XDG_CACHE_HOME"
    with pytest.raises(EwrError, match=told), _compat.compiling("a form"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))  # of a write that fails
