"""Component mode synthesis: sparse matrices of the structure become a small ``ReducedModel``.

Craig-Bampton with every contact degree of freedom on the boundary. The basis holds, column by column: the constraint
modes of the contact degrees of freedom (whose coordinates are the physical displacements), the lowest fixed-interface
modes, and the static response to each load with the interface held, which makes the static state exact. Of a sector of
a ring both cuts are on the boundary, too, and the ring is closed on the reduced matrices: one basis serves all waves.

Source: Craig & Bampton (1968), doi:10.2514/3.4741.
"""

from __future__ import annotations

import itertools
import math
import os
import resource
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import dolfinx
import numpy as np
import scipy.linalg
import scipy.sparse
from mpi4py import MPI
from petsc4py import PETSc

from ewr_fenicsx.errors import InterfaceError, ModesError
from ewr_fenicsx.model.reduced_model import ReducedModel
from ewr_fenicsx.model.restriction import solve_stuck
from ewr_fenicsx.structure import _compat
from ewr_fenicsx.structure.boundaries import list_dofs
from ewr_fenicsx.structure.columns import blocks, factorise, multiply, stack_columns
from ewr_fenicsx.structure.elasticity import Structure
from ewr_fenicsx.structure.interface import Interface
from ewr_fenicsx.structure.modes import Modes, full_stick_modes, group_equal, orient_modes, solve_modes
from ewr_fenicsx.structure.projection import project
from ewr_fenicsx.structure.rigid_motions import find_rigid_motions, refuse_hinges
from ewr_fenicsx.structure.sector_cuts import SectorCuts, list_boundary

_NEGLIGIBLE = 1e-8  # a load vector of which less than this lies outside the modes adds nothing but rounding
_FULL_STICK_MODES = 6  # kept for pictures and reports


@dataclass(frozen=True)
class CraigBampton:
    """The reduced model and the way back to the mesh.

    Attributes:
        model: For the contact solver; the same on every rank.
        basis: This rank's rows of the basis, ``(owned dofs, n)``, column after column; rows that are held are zero. By
            far the largest array of all. Of a sector it has a column for the high cut as well, where the next sector's
            coordinates tell the motion: after those of the low cut.
        interface: The pairs.
        fixed_interface_frequencies: ``(m,)`` [Hz].
        full_stick: Lowest modes of the bonded joint, from the sparse matrices; of a ring in the wave of harmonic 1,
            from the reduced ones, at an instant.
        contact_dofs: Global numbers of the degrees of freedom that the first coordinates are, ``(n_c,)``.
        structure: What was reduced.
        cuts: Of a sector of a ring, ``k`` degrees of freedom on each: the low ones are the next coordinates. None: no
            ring.
    """

    model: ReducedModel
    basis: np.ndarray
    interface: Interface
    fixed_interface_frequencies: np.ndarray
    full_stick: Modes
    contact_dofs: np.ndarray
    structure: Structure
    cuts: SectorCuts | None = None

    @property
    def boundary_dofs(self) -> np.ndarray:
        """Global numbers of the degrees of freedom that the first columns of the basis are."""
        return list_boundary(self.contact_dofs, self.cuts)

    @property
    def low_coordinates(self) -> slice:
        """Coordinates of the model that are displacements of the low cut; none without a ring."""
        first = len(self.contact_dofs)
        return slice(first, first + (len(self.cuts.low) if self.cuts else 0))

    @property
    def modal_coordinates(self) -> range:
        """Coordinates of the model that are fixed-interface modes, by rising frequency."""
        first = self.low_coordinates.stop
        return range(first, first + len(self.fixed_interface_frequencies))

    @property
    def response_coordinates(self) -> range:
        """Coordinates of the model that are static responses to loads, as far as the modes do not hold them."""
        return range(self.modal_coordinates.stop, self.model.size)

    @property
    def most_modes(self) -> int:
        """How many fixed-interface modes there are."""
        return self.structure.mass.getSize()[0] - len(self.structure.fixed) - len(self.boundary_dofs)

    @property
    def full_stick_ratio(self) -> float:
        """Ratio of critical damping of the lowest mode of the bonded joint."""
        model, wave = self.model, self.model.wave_of(1)
        squares, shapes = solve_stuck(model, wave)
        omega = 2 * np.pi * self.full_stick.frequency[0]
        shape = shapes[:, np.argmin(np.abs(squares - omega**2))]
        return float((shape.conj() @ model.matrix("damping", wave) @ shape).real / (2 * omega))

    @property
    def rigid_drag(self) -> float:
        """Largest rate at which damping slows a rigid motion of a body that only the joint holds [1/s]; 0 without."""
        rigid = self.model.rigid_modes
        if not rigid.shape[1]:
            return 0.0
        damping, mass = (rigid.T @ matrix @ rigid for matrix in (self.model.damping, self.model.mass))
        return float(scipy.linalg.eigh(damping, mass, eigvals_only=True)[-1])

    def expand(self, x: np.ndarray, x_next: np.ndarray | None = None) -> dolfinx.fem.Function:
        """The displacement field [m] of real reduced coordinates ``(n,)``, of a ring also of the next sector's."""
        field = dolfinx.fem.Function(self.structure.space)
        field.x.array[: self.basis.shape[0]] = self.basis @ self.join_next(x, x_next)
        field.x.scatter_forward()
        return field

    def join_next(self, x: np.ndarray, x_next: np.ndarray | None) -> np.ndarray:
        """Coordinates of the basis: the model's ``(n,)``, and of a ring the high cut's, by the next sector's."""
        if self.cuts is None:
            return x
        at = self.low_coordinates
        return np.concatenate([x[: at.stop], self.cuts.turn @ x_next[at], x[at.stop :]])


def reduce_structure(
    structure: Structure, interface: Interface, *, modes: int = 30, cuts: SectorCuts | None = None
) -> CraigBampton:
    """Reduces a structure to its contact degrees of freedom, a few modes and the static responses to its loads.

    Args:
        structure: Sparse matrices.
        interface: Pairs of contact nodes.
        modes: Number of fixed-interface modes. With the default the joint compliance of the default fir tree is within
            1e-4 of the full model's up to five times its first full-stick frequency.
        cuts: Of a sector of a ring; None: it is the whole structure.

    Raises:
        InterfaceError: So many pairs that the machine has not the memory.
        ModesError: Modes that did not converge; a part of the mesh that nothing holds; bodies that turn about nodes
            that they share; a rigid motion of a body that is not free of elastic forces.
    """
    comm = structure.mass.comm.tompi4py()
    first = structure.mass.getOwnershipRange()[0]
    contact = _contact_dofs(interface, structure.fixed)
    find_rigid_motions(structure, interface, contact)  # refuses what floats, before a singular matrix is factorised
    if cuts is None:  # what the next sector holds is not known here
        refuse_hinges(structure)
    boundary = list_boundary(contact, cuts)
    columns = len(boundary) + min(modes, structure.mass.getSize()[0])  # too many modes are refused as such, below
    _check_memory(comm.allreduce(structure.mass.getLocalSize()[0], MPI.MAX), columns, len(interface.area))
    interior = _cut_interior(structure, boundary)
    found = solve_modes(interior.stiffness, interior.mass, modes)
    _compat.free_matrices(structure.mass.comm)  # before the wide basis takes its memory
    coupling = _couple_boundary(structure, interior, boundary)
    solve = factorise(interior.stiffness)
    forces = [load.vector.array[interior.dofs - first] for load in structure.loads]
    responses = solve(stack_columns(forces, len(interior.dofs)))
    constraint = (solve(-coupling[:, block].toarray(order="F")) for block in blocks(len(boundary)))
    shapes = stack_columns([vector.array for vector in found.vectors], len(interior.dofs))
    basis = _compose_basis(structure, interior, boundary, constraint, shapes, responses, group_equal(found.frequency))
    del solve, constraint
    _compat.free_matrices(structure.mass.comm)  # the factors among them
    model = project(structure, interface, basis, contact, cuts)
    if cuts is None:
        full_stick = full_stick_modes(structure, interface, _FULL_STICK_MODES)
    else:
        full_stick = Modes(np.zeros(0), [], np.zeros(0))
    del interior
    _compat.free_matrices(structure.mass.comm)
    reduction = CraigBampton(model, basis, interface, found.frequency, full_stick, contact, structure, cuts)
    return reduction if cuts is None else replace(reduction, full_stick=_stick_in_wave(reduction))


def keep_more_modes(reduction: CraigBampton, modes: int) -> CraigBampton:
    """The reduction with more fixed-interface modes; those that it has, and its static responses, are kept.

    Args:
        reduction: What there is.
        modes: Number of modes of the result, more than there are and less than ``reduction.most_modes``: where it is
            all that are left, SLEPc finds none beside those known.

    Raises:
        ModesError: So many modes there are not, or they did not converge.
    """
    structure, boundary = reduction.structure, reduction.boundary_dofs
    known = range(len(boundary), len(boundary) + len(reduction.fixed_interface_frequencies))  # of the basis
    if not len(known) < modes < reduction.most_modes:
        raise ModesError(f"{modes} modes asked for; give more than the {len(known)} there are, and fewer than "
                         f"{reduction.most_modes}, as many as the interior has degrees of freedom")  # fmt: skip
    interior = _cut_interior(structure, boundary)
    here = interior.dofs - structure.mass.getOwnershipRange()[0]
    constraint = (reduction.basis[here, block] for block in blocks(len(boundary)))
    shapes, loads = reduction.basis[here, known.start : known.stop], reduction.basis[here, known.stop :]
    vectors = []
    for shape in shapes.T:
        vectors.append(interior.mass.createVecRight())
        vectors[-1].array[:] = shape
    found = solve_modes(interior.stiffness, interior.mass, modes - len(known), known=vectors)
    frequencies = np.concatenate([reduction.fixed_interface_frequencies, found.frequency])
    rising = np.argsort(frequencies, kind="stable")
    shapes = stack_columns([*shapes.T, *(vector.array for vector in found.vectors)], len(here))[:, rising]
    # what the load responses had outside the modes there were is all that can lie outside more of them
    equal = group_equal(frequencies[rising], known=rising < len(known))  # those that there were stay as they are
    basis = _compose_basis(structure, interior, boundary, constraint, shapes, loads, equal)
    model = project(structure, reduction.interface, basis, reduction.contact_dofs, reduction.cuts)
    del interior, vectors
    _compat.free_matrices(structure.mass.comm)
    return replace(reduction, model=model, basis=basis, fixed_interface_frequencies=frequencies[rising])


def _stick_in_wave(reduction: CraigBampton) -> Modes:
    """Lowest modes of full stick in the wave of harmonic 1: what a sector shows at the instant when it moves most."""
    model, structure = reduction.model, reduction.structure
    wave = model.wave_of(1)
    squares, shapes = solve_stuck(model, wave, _FULL_STICK_MODES)
    vectors = []
    for shape in shapes.T:
        shape = shape * np.exp(-0.5j * np.angle(np.sum(shape**2)))  # the largest real part
        vectors.append(structure.mass.createVecRight())
        joined = reduction.join_next(shape.real, (model.cyclic.lag(wave) * shape).real)
        vectors[-1].array[:] = reduction.basis @ joined
    frequencies = np.sqrt(np.abs(squares)) / (2 * np.pi)
    return Modes(np.copysign(frequencies, squares), vectors, np.full(len(vectors), np.nan))


@dataclass(frozen=True)
class _Interior:
    """What is neither held nor on the boundary: this rank's rows, those of its boundary, and sparse matrices."""

    dofs: np.ndarray
    rows: PETSc.IS  # the same, as PETSc takes them
    boundary: np.ndarray
    stiffness: PETSc.Mat
    mass: PETSc.Mat


def _check_memory(rows: int, columns: int, pairs: int) -> None:
    """That basis ``(rows, columns)`` and reduced matrices could fit into memory at all, before hours of work."""
    needed = 8 * columns * (rows + 3 * columns)
    memory = find_memory(Path("/"))
    if needed > memory:
        raise InterfaceError(
            f"{pairs} pairs on {rows} degrees of freedom a rank: the reduction alone needs {needed / 1e9:.3g} GB, and "
            f"it may have {memory / 1e9:.3g} GB here; take fewer pairs or modes, or a larger mesh_size"
        )


def find_memory(root: Path) -> float:
    """Bytes that this process may have: what the machine has, or less in a container, in a job or by ``ulimit -v``.

    Args:
        root: Of the file system, where Linux tells the limits of control groups, in either of their two versions.
    """
    sizes = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    soft = resource.getrlimit(resource.RLIMIT_AS)[0]
    sizes += [] if soft == resource.RLIM_INFINITY else [soft]
    files = {"": ("sys/fs/cgroup", "memory.max"), "memory": ("sys/fs/cgroup/memory", "memory.limit_in_bytes")}
    with suppress(OSError):  # no Linux
        for line in (root / "proc/self/cgroup").read_text().splitlines():
            _, controller, group = line.split(":", 2)
            if controller in files:
                place, name = files[controller]
                own = Path(group.strip("/"))
                for at in (own, *own.parents):  # a group has no more than those around it
                    with suppress(OSError, ValueError):  # not to be seen from a container; "max"
                        sizes.append(int((root / place / at / name).read_text()))
    return min(sizes)


def _cut_interior(structure: Structure, boundary: np.ndarray) -> _Interior:
    first, last = structure.mass.getOwnershipRange()
    mine = np.sort(boundary[(boundary >= first) & (boundary < last)])
    dofs = np.setdiff1d(np.arange(first, last), np.concatenate([mine, structure.fixed_dofs]))
    rows = PETSc.IS().createGeneral(dofs.astype(np.int32), comm=structure.mass.comm)
    matrices = (matrix.createSubMatrix(rows, rows) for matrix in (structure.stiffness, structure.mass))
    return _Interior(dofs, rows, mine, *matrices)


def _couple_boundary(structure: Structure, interior: _Interior, boundary: np.ndarray) -> scipy.sparse.csr_matrix:
    """This rank's rows of the stiffness between interior and boundary degrees of freedom, ``(rows, n_b)``."""
    mine = PETSc.IS().createGeneral(interior.boundary.astype(np.int32), comm=structure.mass.comm)
    starts, columns, values = structure.stiffness.createSubMatrix(interior.rows, mine).getValuesCSR()
    place = np.argsort(boundary)[columns]  # the columns are sorted by number, on each rank and from rank to rank
    return scipy.sparse.csr_matrix((values, place, starts), shape=(len(interior.dofs), len(boundary)))


def _compose_basis(
    structure: Structure,
    interior: _Interior,
    boundary: np.ndarray,
    constraint: Iterable[np.ndarray],
    shapes: np.ndarray,
    responses: np.ndarray,
    equal: list[np.ndarray],
) -> np.ndarray:
    """Columns of the basis: constraint modes, fixed-interface modes, and what load responses have outside of these.

    Args:
        structure: What is reduced.
        interior: Its interior.
        boundary: Numbers of the degrees of freedom in contact and on cuts.
        constraint: Constraint modes in the interior, some columns at a time, so that they are in memory but once.
        shapes: Fixed-interface modes ``(rows, m)``, mass-orthonormal.
        responses: To loads, ``(rows, l)``.
        equal: Groups of modes that share a frequency and may be mixed.
    """
    first, last = structure.mass.getOwnershipRange()
    rest = _residual_vectors(responses, shapes, interior.mass)
    basis = np.zeros((last - first, len(boundary) + shapes.shape[1] + rest.shape[1]), order="F")
    columns = itertools.chain.from_iterable(block.T for block in itertools.chain(constraint, (shapes, rest)))
    for k, column in enumerate(columns):
        basis[interior.dofs - first, k] = column
    for k, dof in enumerate(boundary):
        if first <= dof < last:
            basis[dof - first, k] = 1.0
    orient_modes(basis, len(boundary), equal, structure.mass)
    return basis


def _contact_dofs(interface: Interface, fixed: np.ndarray) -> np.ndarray:
    """Free degrees of freedom of the pairs, pair by pair: all components of A's node, all of B's."""
    dofs = np.hstack([list_dofs(nodes, interface.dimension) for nodes in (interface.nodes_a, interface.nodes_b)])
    return dofs[~np.isin(dofs, fixed)]


def _residual_vectors(responses: np.ndarray, shapes: np.ndarray, mass: PETSc.Mat) -> np.ndarray:
    """The part of the load responses that the modes do not hold, mass-orthonormal; negligible ones are left out."""
    comm = mass.comm.tompi4py()
    basis = shapes
    for response in responses.T:
        rest = response.copy()
        size = math.sqrt(_inner(rest, multiply(mass, rest[:, None])[:, 0], comm))
        for _ in range(2):  # the second pass removes what rounding left
            rest -= basis @ comm.allreduce(basis.T @ multiply(mass, rest[:, None])[:, 0])
        norm = math.sqrt(max(0.0, _inner(rest, multiply(mass, rest[:, None])[:, 0], comm)))
        if norm > _NEGLIGIBLE * size:
            basis = np.column_stack([basis, rest / norm])
    return basis[:, shapes.shape[1] :]


def _inner(x: np.ndarray, y: np.ndarray, comm: MPI.Comm) -> float:
    with np.errstate(over="ignore", invalid="ignore"):  # of loads too large to square, which the model refuses
        return comm.allreduce(float(x @ y))
