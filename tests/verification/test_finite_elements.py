"""The finite elements against closed forms: beam theory, patch test, rigid bodies, and welding."""

from __future__ import annotations

import subprocess
import sys
from math import pi
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
import scipy.sparse
import scipy.sparse.linalg
from counted_calls import count_calls
from mpi4py import MPI
from petsc4py import PETSc
from sparse_matrices import to_scipy

from ewr_fenicsx.errors import ModesError
from ewr_fenicsx.structure import modes as search_of_modes
from ewr_fenicsx.structure.elasticity import BoundaryForce, OutputSpec, assemble_structure
from ewr_fenicsx.structure.interface import pair_interface
from ewr_fenicsx.structure.materials import TITANIUM, Material, RayleighRatios
from ewr_fenicsx.structure.mesh import build_mesh
from ewr_fenicsx.structure.modes import full_stick_modes, solve_modes, tie_pairs

GEOMETRY = Path(__file__).parents[1] / "geometry"
TWO_BLOCKS = GEOMETRY / "two_blocks.py"
FIR_TREE = Path(__file__).parents[2] / "geometry" / "fir_tree.py"
LENGTH, HEIGHT = 0.1, 0.01


def assemble(source, parameters=None, material=TITANIUM, **options):
    mesh = build_mesh(source, parameters or {}, MPI.COMM_WORLD)
    return assemble_structure(mesh, materials=dict.fromkeys(mesh.bodies, material), **options)


def timoshenko_cantilever(material: Material, length: float, height: float, count: int) -> np.ndarray:
    """Bending frequencies [Hz] of a clamped-free beam of rectangular section.

    Source: Huang (1961), doi:10.1115/1.3641787, clamped-free frequency equation; shear coefficient of Cowper (1966).
    """
    shear = material.young / (2 * (1 + material.poisson))
    coefficient = 10 * (1 + material.poisson) / (12 + 11 * material.poisson)
    r2 = height**2 / 12 / length**2
    s2 = material.young / (coefficient * shear) * r2
    scale = np.sqrt(material.young * height**2 / 12 / (material.density * length**4))

    def equation(b: float) -> float:
        root = np.sqrt((r2 - s2) ** 2 + 4 / b**2)
        alpha, beta = (np.sqrt((sign * (r2 + s2) + root) / 2) for sign in (-1, 1))
        return (
            2
            + (b**2 * (r2 - s2) ** 2 + 2) * np.cosh(b * alpha) * np.cos(b * beta)
            - b * (r2 + s2) / np.sqrt(1 - b**2 * r2 * s2) * np.sinh(b * alpha) * np.sin(b * beta)
        )

    grid = np.linspace(0.5, 130, 2000)
    changes = np.flatnonzero(np.diff(np.sign([equation(b) for b in grid])))[:count]
    return np.array([scipy.optimize.brentq(equation, grid[k], grid[k + 1]) for k in changes]) * scale / (2 * pi)


def hold_clamp(structure):
    """Stiffness and mass without the clamped degrees of freedom."""
    free = np.setdiff1d(np.arange(structure.mass.getSize()[0]), structure.fixed_dofs).astype(np.int32)
    rows = PETSc.IS().createGeneral(free, comm=PETSc.COMM_SELF)
    return structure.stiffness.createSubMatrix(rows, rows), structure.mass.createSubMatrix(rows, rows)


def solve_cantilever(degree: int, columns: int, poisson: float) -> np.ndarray:
    """First frequencies of the blocks welded into one beam and held at the lower end: two bending, one axial."""
    shape = {
        "width": HEIGHT,
        "blade_height": LENGTH / 2,
        "disk_height": LENGTH / 2,
        "columns": columns,
        "blade_rows": 5 * columns,
        "disk_rows": 5 * columns,
        "welded": True,
    }
    material = Material(TITANIUM.young, poisson, TITANIUM.density)
    return solve_modes(*hold_clamp(assemble(TWO_BLOCKS, shape, material, degree=degree)), 3).frequency


# without lateral contraction the clamped corners are no singularities, and beam theory holds at the clamp
@pytest.mark.parametrize("poisson, columns, tolerances", [(0.0, 4, (3e-5, 2e-4)), (0.342, 4, (2e-3, 2.5e-3))])
def test_cantilever_bends_as_timoshenko_says(poisson, columns, tolerances):
    expected = timoshenko_cantilever(Material(TITANIUM.young, poisson, TITANIUM.density), LENGTH, HEIGHT, 2)
    error = solve_cantilever(2, columns, poisson)[:2] / expected - 1
    assert (np.abs(error) < tolerances).all(), error


@pytest.mark.parametrize("degree, rate", [(1, 2), (2, 4)])
def test_axial_frequency_converges_at_the_elements_rate(degree, rate):
    """Against sqrt(E / rho) / (4 L), exact for zero Poisson's ratio; the error falls like h^(2 p)."""
    exact = np.sqrt(TITANIUM.young / TITANIUM.density) / (4 * LENGTH)
    coarse, fine = (solve_cantilever(degree, columns, 0.0)[2] / exact - 1 for columns in (1, 2))
    assert 0 < fine < coarse
    assert np.log2(coarse / fine) == pytest.approx(rate, abs=0.05)
    assert fine < {1: 3e-4, 2: 3e-8}[degree]


@pytest.mark.parametrize("degree, columns, rate", [(1, (2, 4, 8), 2), (2, (1, 2, 4), 4)])
def test_bending_frequency_converges_at_the_elements_rate(degree, columns, rate):
    """Three meshes, each twice as fine: the differences fall like h^(2 p)."""
    first, second, third = (solve_cantilever(degree, c, 0.0)[0] for c in columns)
    assert np.log2((first - second) / (second - third)) == pytest.approx(rate, abs=0.2)


def test_modes_of_a_slender_body_are_as_exact_as_others():
    """Those far above the lowest, too, as of a beam of 1 m that is 6 mm thick; also besides modes that are known."""
    shape = {"width": 0.006, "blade_height": 0.5, "disk_height": 0.5, "columns": 3, "blade_rows": 80, "disk_rows": 80}
    matrices = hold_clamp(assemble(TWO_BLOCKS, shape | {"welded": True}))
    modes = solve_modes(*matrices, 30)
    others = solve_modes(*matrices, 20, known=modes.vectors[:10])
    assert max(*modes.residual[10:], *others.residual) < 1e-10
    dense = (to_scipy(matrix).toarray() for matrix in matrices)
    exact = np.sqrt(scipy.linalg.eigh(*dense, eigvals_only=True, subset_by_index=[0, 29])) / (2 * pi)
    np.testing.assert_allclose(modes.frequency[3:], exact[3:], rtol=1e-6)  # lower ones are lost in the dense solve
    np.testing.assert_allclose(others.frequency, modes.frequency[10:], rtol=1e-9)


@pytest.mark.parametrize(("strings", "count"), [(10, 20), (12, 30), (30, 30)])
def test_modes_of_parts_that_are_alike_are_all_found(strings, count):
    """Each frequency of a string of 50 masses as often as there are strings; also besides modes that are known."""
    masses = 50
    string = scipy.sparse.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(masses, masses))
    side_by_side = scipy.sparse.kron(scipy.sparse.identity(strings), string), scipy.sparse.identity(strings * masses)
    csr = [scipy.sparse.csr_matrix(matrix) for matrix in side_by_side]
    matrices = [PETSc.Mat().createAIJ(m.shape, csr=(m.indptr, m.indices, m.data)) for m in csr]
    exact = np.sin(pi * np.arange(1, masses + 1) / (2 * masses + 2)).repeat(strings) / pi
    modes = solve_modes(*matrices, count)
    np.testing.assert_allclose(modes.frequency, exact[:count], rtol=1e-9)
    others = solve_modes(*matrices, count, known=modes.vectors)
    np.testing.assert_allclose(others.frequency, exact[count : 2 * count], rtol=1e-9)


def test_modes_that_are_all_there_are_not_looked_for_again(monkeypatch):
    """They are counted; also besides modes that are known, and around a shift."""
    searches = count_calls(monkeypatch, search_of_modes, "_search")
    matrices = hold_clamp(assemble(TWO_BLOCKS, {"welded": True, "width": 0.1}))
    lowest = solve_modes(*matrices, 12)
    others = solve_modes(*matrices, 8, known=lowest.vectors[:4])
    np.testing.assert_allclose(others.frequency, lowest.frequency[4:], rtol=1e-9)
    shift = (2 * pi) ** 2 * np.mean(lowest.frequency[4:6] ** 2)
    around = solve_modes(*matrices, 3, shift=shift)
    nearest = np.argsort(np.abs(lowest.frequency**2 - shift / (2 * pi) ** 2))[:3]
    np.testing.assert_allclose(around.frequency, lowest.frequency[np.sort(nearest)], rtol=1e-9)
    assert len(searches) == 3


@pytest.mark.parametrize("degree", [1, 2])
def test_free_body_has_three_rigid_modes(degree):
    """Their eigenvalues vanish to 1e-9 of the first elastic one."""
    structure = assemble(TWO_BLOCKS, {"welded": True, "skew": 0.01}, degree=degree, clamp=())
    modes = solve_modes(structure.stiffness, structure.mass, 5, shift=-((2 * pi * 1000) ** 2))
    eigenvalues = modes.frequency**2
    assert eigenvalues[3] > 1e6
    assert (eigenvalues[:3] < 1e-9 * eigenvalues[3]).all()


def test_more_modes_than_degrees_of_freedom_are_refused():
    structure = assemble(TWO_BLOCKS, {"columns": 1, "blade_rows": 1, "disk_rows": 1})
    with pytest.raises(ModesError, match="17 modes asked for; the matrices have 16"):
        solve_modes(structure.stiffness, structure.mass, 17)


def test_floating_structure_without_shift_is_refused():
    structure = assemble(TWO_BLOCKS, clamp=())
    with pytest.raises(ModesError, match="a body floats and the stiffness is singular"):
        solve_modes(structure.stiffness, structure.mass, 4)


def test_a_hinge_is_lost_in_rounding():
    """All modes become its turn, and none is left to mix with it."""
    with pytest.raises(ModesError, match=r"is lost in rounding, .* the stiffness is singular"):
        solve_modes(*hold_clamp(assemble(TWO_BLOCKS.with_name("hinged.py"), {})), 10)


def test_a_body_far_softer_than_another_is_not_told_to_float_only():
    """As by 210 for 210e9 Pa in one of two materials: nothing floats, and a scene has no shift to give."""
    mesh = build_mesh(FIR_TREE, {}, MPI.COMM_WORLD)
    structure = assemble_structure(mesh, materials={"blade": Material(210.0, 0.3, 7800.0), "disk": TITANIUM})
    with pytest.raises(ModesError, match=r"one is far softer than another; .* or see the Young's moduli \[Pa\]"):
        full_stick_modes(structure, pair_interface(structure), 1)


def test_modes_of_a_very_slender_body_come_back_by_what_is_advised():
    """A clamped plate of 3 m that is 6 mm thick; cells along it make no difference."""

    def hold_plate(columns: int, rows: int, width: float = 0.006):
        shape = {"width": width, "blade_height": 1.5, "disk_height": 1.5, "welded": True}
        shape |= {"columns": columns, "blade_rows": rows, "disk_rows": rows}
        return hold_clamp(assemble(TWO_BLOCKS, shape, degree=2))

    fine = hold_plate(8, 150)
    for matrices in (fine, hold_plate(8, 50)):
        with pytest.raises(ModesError, match=r"one is very slender, .* take fewer cells across .* or make it thicker"):
            solve_modes(*matrices, 3)
    (thin,), (thick,) = (timoshenko_cantilever(TITANIUM, 3.0, height, 1) for height in (0.006, 0.012))
    for matrices, shift, expected in (
        (fine, -((2 * pi * 10) ** 2), thin),
        (hold_plate(2, 150), 0.0, thin),
        (hold_plate(8, 150, 0.012), 0.0, thick),
    ):
        assert solve_modes(*matrices, 3, shift=shift).frequency[0] == pytest.approx(expected, rel=1e-3)


MEMBRANE_IN_LITTLE_MEMORY = """
import resource
import scipy.sparse as sparse
from pathlib import Path
from petsc4py import PETSc
from ewr_fenicsx.structure.modes import solve_modes

def membrane(n):
    string = sparse.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(n, n))
    both = (sparse.kronsum(string, string).tocsr(), sparse.identity(n * n, format="csr"))
    return [PETSc.Mat().createAIJ(m.shape, csr=(m.indptr, m.indices, m.data)) for m in both]

solve_modes(*membrane(20), 3)
large = membrane(500)
in_use = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (in_use + 100_000_000, -1))
try:
    solve_modes(*large, 3)
except MemoryError as error:
    print(error)
"""


def test_a_lack_of_memory_is_no_floating_body():
    done = subprocess.run([sys.executable, "-c", MEMBRANE_IN_LITTLE_MEMORY], capture_output=True, text=True, check=True)
    assert done.stdout == "the factors of a matrix of 250000 rows do not fit\n"


def stretch_patch(plane: str, degree: int, quadrilaterals: bool) -> tuple[float, float, float]:
    """Relative errors under a linear displacement of skewed elements: of the energy, of the balance of the inner nodes
    and of the traction on the tip."""
    structure = assemble(
        TWO_BLOCKS,
        {"welded": True, "skew": 0.013, "quadrilaterals": quadrilaterals},
        degree=degree,
        plane=plane,
        thickness=0.02,
        outputs=[OutputSpec("tip", "tip", (0, 1))],
    )
    x, y = structure.space.tabulate_dof_coordinates()[:, :2].T
    gradient = 1e-3 * np.array([[1.0, 0.4], [-0.2, 0.7]])
    u = structure.mass.createVecRight()
    u.array[:] = (np.column_stack([x, y]) @ gradient.T).ravel()

    strain = (gradient + gradient.T) / 2
    young, poisson = TITANIUM.young, TITANIUM.poisson
    if plane == "strain":
        young, poisson = young / (1 - poisson**2), poisson / (1 - poisson)
    stress = young / (1 - poisson**2) * ((1 - poisson) * strain + poisson * np.trace(strain) * np.eye(2))
    force = structure.stiffness * u
    volume = 0.04 * 0.09 * 0.02
    energy = abs(u.dot(force) / ((stress * strain).sum() * volume) - 1)
    nodal = force.array.reshape(-1, 2)
    lean = 0.013 / 0.06  # of the blade's left edge
    left = np.where(y > 0.03, (y - 0.03) * lean, 0)
    inner = (y > 1e-9) & (y < 0.09 - 1e-9) & (x > left + 1e-9) & (x < left + 0.04 - 1e-9)
    assert inner.sum() > 50
    balance = np.abs(nodal[inner]).max() / np.abs(nodal).max()
    # corner nodes of the tip carry a share of the side's traction as well: leave them out
    edge = (y > 0.09 - 1e-9) & (x > left + 1e-9) & (x < left + 0.04 - 1e-9)
    share = structure.outputs["tip"].array.reshape(-1, 2)[edge, 1]
    traction = np.abs(nodal[edge] / np.outer(share * 0.04 * 0.02, stress[:, 1]) - 1).max()
    return float(energy), float(balance), float(traction)


@pytest.mark.parametrize("plane", ["stress", "strain"])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("quadrilaterals", [True, False])
def test_static_patch(plane, degree, quadrilaterals):
    """A linear displacement on skewed elements: inner nodes in balance, exact energy, exact traction on the tip."""
    energy, balance, traction = stretch_patch(plane, degree, quadrilaterals)
    assert energy < 1e-11 and balance < 1e-11 and traction < 1e-9


def receptance(structure, transformation, frequencies):
    """Tip displacement for the tip force, by sparse direct solution of the full model."""
    mass, damping, stiffness = (
        transformation.T @ to_scipy(m) @ transformation
        for m in (structure.mass, structure.damping, structure.stiffness)
    )
    force, row = (transformation.T @ v.array for v in (structure.loads[0].vector, structure.outputs["tip"]))
    omegas = 2 * pi * np.asarray(frequencies)
    return np.array(
        [row @ scipy.sparse.linalg.spsolve((stiffness + 1j * w * damping - w**2 * mass).tocsc(), force) for w in omegas]
    )


@pytest.mark.parametrize(
    "joint, welded, pairs",
    [
        ((TWO_BLOCKS, {}), (TWO_BLOCKS, {"welded": True}), 7),
        ((FIR_TREE, {}), (GEOMETRY / "welded_fir_tree.py", {}), 40),
    ],
)
def test_bonded_pairs_are_one_welded_mesh(joint, welded, pairs):
    """Tying the nodes of every pair gives the compliance and the modes of the mesh whose nodes were merged."""
    options = {
        "damping": RayleighRatios((500.0, 3000.0), (0.002, 0.002)),
        "loads": [BoundaryForce("f", "tip", (1.0, 0.3), 1)],
        "outputs": [OutputSpec("tip", "tip", (1.0, 0.3))],
    }
    tied, merged = assemble(*joint, **options), assemble(*welded, **options)
    interface = pair_interface(tied)
    assert len(interface.area) == pairs
    assert tied.mass.getSize()[0] == merged.mass.getSize()[0] + 2 * pairs
    frequencies = [0.0, 400.0, 1000.0, 2180.0, 5450.0]  # a resonance would magnify rounding by its quality factor
    identity = scipy.sparse.identity(merged.mass.getSize()[0], format="csc")
    expected = receptance(
        merged, identity[:, np.setdiff1d(np.arange(identity.shape[0]), merged.fixed_dofs)], frequencies
    )
    found = receptance(tied, to_scipy(tie_pairs(tied, interface)), frequencies)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    modes = full_stick_modes(tied, interface, 4)
    np.testing.assert_allclose(modes.frequency, solve_modes(*hold_clamp(merged), 4).frequency, rtol=1e-9)
    for vector in modes.vectors:
        size = vector.norm()
        assert (
            max(abs(interface.normal_gap @ vector.array).max(), abs(interface.tangential_slip @ vector.array).max())
            < 1e-14 * size
        )
        assert abs(vector.array[tied.fixed_dofs]).max() == 0


def test_first_full_stick_mode_of_the_default_fir_tree():
    """1090 Hz within 1 %: the frequency that the geometry was designed for."""
    structure = assemble(FIR_TREE)
    assert full_stick_modes(structure, pair_interface(structure), 1).frequency[0] == pytest.approx(1090.0, rel=0.01)
