"""Component mode synthesis: sparse matrices of the structure become a small ``ReducedModel``.

Craig-Bampton with every contact degree of freedom on the boundary. The basis holds, column by column: the constraint
modes of the contact degrees of freedom (whose coordinates are the physical displacements), the lowest fixed-interface
modes, and the static response to each load with the interface held, which makes the static state exact.

Source: Craig & Bampton (1968), doi:10.2514/3.4741.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Iterable
from dataclasses import dataclass, replace

import dolfinx
import numpy as np
import scipy.linalg
import scipy.sparse
from mpi4py import MPI
from petsc4py import PETSc

from ewr_fenicsx.errors import InterfaceError, ModesError
from ewr_fenicsx.model.reduced_model import ReducedModel
from ewr_fenicsx.structure import _compat
from ewr_fenicsx.structure.boundaries import list_dofs
from ewr_fenicsx.structure.columns import blocks, factorise, multiply, stack_columns
from ewr_fenicsx.structure.elasticity import Structure
from ewr_fenicsx.structure.interface import Interface
from ewr_fenicsx.structure.modes import Modes, full_stick_modes, solve_modes
from ewr_fenicsx.structure.orientation import group_equal, orient_modes
from ewr_fenicsx.structure.rigid_motions import find_rigid_motions

_NEGLIGIBLE = 1e-8  # a load vector of which less than this lies outside the modes adds nothing but rounding
_FULL_STICK_MODES = 6  # kept for pictures and reports


@dataclass(frozen=True)
class CraigBampton:
    """The reduced model and the way back to the mesh.

    Attributes:
        model: For the contact solver; the same on every rank.
        basis: This rank's rows of the basis, ``(owned dofs, n)``, column after column; rows that are held are zero. By
            far the largest array of all.
        interface: The pairs.
        fixed_interface_frequencies: ``(m,)`` [Hz].
        full_stick: Lowest modes of the bonded joint, from the sparse matrices.
        contact_dofs: Global numbers of the degrees of freedom that the first coordinates are, ``(n_c,)``.
        structure: What was reduced.
    """

    model: ReducedModel
    basis: np.ndarray
    interface: Interface
    fixed_interface_frequencies: np.ndarray
    full_stick: Modes
    contact_dofs: np.ndarray
    structure: Structure

    @property
    def modal_coordinates(self) -> range:
        """Coordinates of the model that are fixed-interface modes, by rising frequency."""
        first = len(self.contact_dofs)
        return range(first, first + len(self.fixed_interface_frequencies))

    @property
    def response_coordinates(self) -> range:
        """Coordinates of the model that are static responses to loads, as far as the modes do not hold them."""
        return range(self.modal_coordinates.stop, self.model.size)

    @property
    def most_modes(self) -> int:
        """How many fixed-interface modes there are."""
        return self.structure.mass.getSize()[0] - len(self.structure.fixed) - len(self.contact_dofs)

    @property
    def full_stick_ratio(self) -> float:
        """Ratio of critical damping of the lowest mode of the bonded joint."""
        model = self.model
        squares, shapes = _solve_stuck(model.mass, model.stiffness, np.vstack([model.normal, model.tangential]))
        omega = 2 * np.pi * self.full_stick.frequency[0]
        shape = shapes[:, np.argmin(np.abs(squares - omega**2))]
        return float(shape @ model.damping @ shape / (2 * omega))

    @property
    def rigid_drag(self) -> float:
        """Largest rate at which damping slows a rigid motion of a body that only the joint holds [1/s]; 0 without."""
        rigid = self.model.rigid_modes
        if not rigid.shape[1]:
            return 0.0
        damping, mass = (rigid.T @ matrix @ rigid for matrix in (self.model.damping, self.model.mass))
        return float(scipy.linalg.eigh(damping, mass, eigvals_only=True)[-1])

    def expand(self, x: np.ndarray) -> dolfinx.fem.Function:
        """The displacement field [m] of real reduced coordinates ``(n,)``."""
        field = dolfinx.fem.Function(self.structure.space)
        field.x.array[: self.basis.shape[0]] = self.basis @ x
        field.x.scatter_forward()
        return field


def reduce_structure(structure: Structure, interface: Interface, *, modes: int = 30) -> CraigBampton:
    """Reduces a structure to its contact degrees of freedom, a few modes and the static responses to its loads.

    Args:
        structure: Sparse matrices.
        interface: Pairs of contact nodes.
        modes: Number of fixed-interface modes. With the default the joint compliance of the default fir tree is within
            1e-4 of the full model's up to five times its first full-stick frequency.

    Raises:
        InterfaceError: So many pairs that the machine has not the memory.
        ModesError: Modes that did not converge; a part of the mesh that nothing holds; a rigid motion of a body that is
            not free of elastic forces.
    """
    comm = structure.mass.comm.tompi4py()
    first = structure.mass.getOwnershipRange()[0]
    contact = _contact_dofs(interface, structure.fixed)
    find_rigid_motions(structure, interface, contact)  # refuses what floats, before a singular matrix is factorised
    columns = len(contact) + min(modes, structure.mass.getSize()[0])  # too many modes are refused as such, below
    _check_memory(comm.allreduce(structure.mass.getLocalSize()[0], MPI.MAX), columns, len(interface.area))
    interior = _cut_interior(structure, contact)
    found = solve_modes(interior.stiffness, interior.mass, modes)
    _compat.free_matrices(structure.mass.comm)  # before the wide basis takes its memory
    coupling = _couple_contact(structure, interior, contact)
    solve = factorise(interior.stiffness)
    forces = [load.vector.array[interior.dofs - first] for load in structure.loads]
    responses = solve(stack_columns(forces, len(interior.dofs)))
    constraint = (solve(-coupling[:, block].toarray(order="F")) for block in blocks(len(contact)))
    shapes = stack_columns([vector.array for vector in found.vectors], len(interior.dofs))
    basis = _compose_basis(structure, interior, contact, constraint, shapes, responses, group_equal(found.frequency))
    del solve, constraint
    _compat.free_matrices(structure.mass.comm)  # the factors among them
    model = _project(structure, interface, basis, contact)
    full_stick = full_stick_modes(structure, interface, _FULL_STICK_MODES)
    del interior
    _compat.free_matrices(structure.mass.comm)
    return CraigBampton(model, basis, interface, found.frequency, full_stick, contact, structure)


def keep_more_modes(reduction: CraigBampton, modes: int) -> CraigBampton:
    """The reduction with more fixed-interface modes; those that it has, and its static responses, are kept.

    Args:
        reduction: What there is.
        modes: Number of modes of the result, more than there are and at most ``reduction.most_modes``.

    Raises:
        ModesError: So many modes there are not, or they did not converge.
    """
    structure, contact = reduction.structure, reduction.contact_dofs
    known = reduction.modal_coordinates
    if not len(known) < modes <= reduction.most_modes:
        raise ModesError(f"{modes} modes asked for; give more than the {len(known)} there are, at most "
                         f"{reduction.most_modes}, as many as the interior has degrees of freedom")  # fmt: skip
    interior = _cut_interior(structure, contact)
    here = interior.dofs - structure.mass.getOwnershipRange()[0]
    constraint = (reduction.basis[here, block] for block in blocks(len(contact)))
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
    basis = _compose_basis(structure, interior, contact, constraint, shapes, loads, equal)
    model = _project(structure, reduction.interface, basis, contact)
    del interior, vectors
    _compat.free_matrices(structure.mass.comm)
    return replace(reduction, model=model, basis=basis, fixed_interface_frequencies=frequencies[rising])


@dataclass(frozen=True)
class _Interior:
    """What is neither held nor in contact: this rank's rows, those of its contact dofs, and sparse matrices."""

    dofs: np.ndarray
    rows: PETSc.IS  # the same, as PETSc takes them
    boundary: np.ndarray
    stiffness: PETSc.Mat
    mass: PETSc.Mat


def _check_memory(rows: int, columns: int, pairs: int) -> None:
    """That basis ``(rows, columns)`` and reduced matrices could fit into this machine at all, before hours of work."""
    needed = 8 * columns * (rows + 3 * columns)
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if needed > memory:
        raise InterfaceError(
            f"{pairs} pairs on {rows} degrees of freedom a rank: the reduction alone needs {needed / 1e9:.3g} GB, and "
            f"this machine has {memory / 1e9:.3g} GB; take fewer pairs or modes, or a larger mesh_size"
        )


def _cut_interior(structure: Structure, contact: np.ndarray) -> _Interior:
    first, last = structure.mass.getOwnershipRange()
    boundary = np.sort(contact[(contact >= first) & (contact < last)])
    dofs = np.setdiff1d(np.arange(first, last), np.concatenate([boundary, structure.fixed_dofs]))
    rows = PETSc.IS().createGeneral(dofs.astype(np.int32), comm=structure.mass.comm)
    matrices = (matrix.createSubMatrix(rows, rows) for matrix in (structure.stiffness, structure.mass))
    return _Interior(dofs, rows, boundary, *matrices)


def _couple_contact(structure: Structure, interior: _Interior, contact: np.ndarray) -> scipy.sparse.csr_matrix:
    """This rank's rows of the stiffness between interior and contact degrees of freedom, ``(rows, n_c)``."""
    boundary = PETSc.IS().createGeneral(interior.boundary.astype(np.int32), comm=structure.mass.comm)
    starts, columns, values = structure.stiffness.createSubMatrix(interior.rows, boundary).getValuesCSR()
    place = np.argsort(contact)[columns]  # the columns are sorted by number, on each rank and from rank to rank
    return scipy.sparse.csr_matrix((values, place, starts), shape=(len(interior.dofs), len(contact)))


def _compose_basis(
    structure: Structure,
    interior: _Interior,
    contact: np.ndarray,
    constraint: Iterable[np.ndarray],
    shapes: np.ndarray,
    responses: np.ndarray,
    equal: list[np.ndarray],
) -> np.ndarray:
    """Columns of the basis: constraint modes, fixed-interface modes, and what load responses have outside of these.

    Args:
        structure: What is reduced.
        interior: Its interior.
        contact: Numbers of the contact degrees of freedom.
        constraint: Constraint modes in the interior, some columns at a time, so that they are in memory but once.
        shapes: Fixed-interface modes ``(rows, m)``, mass-orthonormal.
        responses: To loads, ``(rows, l)``.
        equal: Groups of modes that share a frequency and may be mixed.
    """
    first, last = structure.mass.getOwnershipRange()
    rest = _residual_vectors(responses, shapes, interior.mass)
    basis = np.zeros((last - first, len(contact) + shapes.shape[1] + rest.shape[1]), order="F")
    columns = itertools.chain.from_iterable(block.T for block in itertools.chain(constraint, (shapes, rest)))
    for k, column in enumerate(columns):
        basis[interior.dofs - first, k] = column
    for k, dof in enumerate(contact):
        if first <= dof < last:
            basis[dof - first, k] = 1.0
    orient_modes(basis, len(contact), equal, structure.mass)
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


def _project(structure: Structure, interface: Interface, basis: np.ndarray, contact: np.ndarray) -> ReducedModel:
    comm = structure.mass.comm.tompi4py()
    count, contacts = basis.shape[1], len(contact)

    def rows(operator) -> np.ndarray:
        return np.hstack([operator[:, contact].toarray(), np.zeros((operator.shape[0], count - contacts))])

    mass, stiffness = _project_mass(structure, basis), _project_stiffness(structure, basis, contact)
    damping = structure.rayleigh.alpha * mass + structure.rayleigh.beta * stiffness
    normal, tangential = rows(interface.normal_gap), rows(interface.tangential_slip)
    load: dict[int, np.ndarray] = {}
    for entry in structure.loads:
        amplitude = entry.amplitude * _sum(basis.T @ entry.vector.array, comm)
        load[entry.harmonic] = load.get(entry.harmonic, 0) + amplitude
    outputs = {name: _sum(basis.T @ row.array, comm) for name, row in structure.outputs.items()}
    rigid = _rigid_motions(structure, interface, contact, count, stiffness)
    if structure.modal_damping is not None:
        held = np.vstack([normal, tangential])
        damping = _damp_modes(mass, stiffness, held, rigid.shape[1], structure.modal_damping)
    return ReducedModel(mass, damping, stiffness, normal, tangential, load, interface.area, rigid, outputs)


def _project_mass(structure: Structure, basis: np.ndarray) -> np.ndarray:
    count = basis.shape[1]
    lower = np.zeros((count, count))
    for block in blocks(count):
        lower[block.start :, block] = basis[:, block.start :].T @ multiply(structure.mass, basis[:, block])
    lower = np.tril(_sum(lower, structure.mass.comm.tompi4py()))
    return lower + np.tril(lower, -1).T


def _project_stiffness(structure: Structure, basis: np.ndarray, contact: np.ndarray) -> np.ndarray:
    """The forces of constraint modes act where the other modes rest, at the contact degrees of freedom."""
    first, last = structure.stiffness.getOwnershipRange()
    count, contacts = basis.shape[1], len(contact)
    mine = np.flatnonzero((contact >= first) & (contact < last))
    reduced = np.zeros((count, count))
    for block in blocks(contacts):
        reduced[mine, block] = multiply(structure.stiffness, basis[:, block])[contact[mine] - first]
    others = basis[:, contacts:]
    reduced[contacts:, contacts:] = others.T @ multiply(structure.stiffness, others)
    reduced = _sum(reduced, structure.stiffness.comm.tompi4py())
    return 0.5 * (reduced + reduced.T)


def _solve_stuck(mass: np.ndarray, stiffness: np.ndarray, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squared angular frequencies ``(k,)``, rising, and mass-normalised shapes ``(n, k)`` where rows ``held`` rest."""
    stuck = scipy.linalg.null_space(held)
    values, vectors = scipy.linalg.eigh(stuck.T @ stiffness @ stuck, stuck.T @ mass @ stuck)
    return values, stuck @ vectors


def _damp_modes(mass: np.ndarray, stiffness: np.ndarray, held: np.ndarray, floating: int, ratio: float) -> np.ndarray:
    """Damping with a ratio for each mode of the open joint, and for the modes of full stick that hold floating bodies.

    ``D = M Phi diag(2 ratio omega) Phi^T M`` with the mass-normalised modes Phi of the open joint, which span all
    motions: modes of full stick alone would leave out those that it forbids, and overdamp them where the joint opens.
    A mode of the joint held in any way then has at most this ratio, the root being concave (Jensen). Where the joint
    holds ``floating`` rigid motions, which are not damped, it has far less: what the lowest as many modes of full stick
    lack is added. That drags the rigid motions themselves, against the ground, and the lowest elastic modes of the open
    joint have somewhat more than the ratio.

    Args:
        mass, stiffness: ``(n, n)``.
        held: ``(m, n)`` rows of the joint.
        floating: Number of rigid motions of the open joint.
        ratio: Of critical damping.
    """
    values, vectors = scipy.linalg.eigh(stiffness, mass)
    weighted = mass @ vectors
    damping = (weighted * (2 * ratio * np.sqrt(np.maximum(values, 0)))) @ weighted.T
    if floating:
        values, shapes = (part[..., :floating] for part in _solve_stuck(mass, stiffness, held))
        lack = np.diag(2 * ratio * np.sqrt(np.maximum(values, 0))) - shapes.T @ damping @ shapes
        damping += mass @ shapes @ lack @ shapes.T @ mass
    return 0.5 * (damping + damping.T)


def _rigid_motions(
    structure: Structure, interface: Interface, contact: np.ndarray, count: int, stiffness: np.ndarray
) -> np.ndarray:
    """``find_rigid_motions`` in the coordinates of the model, ``(n, r)``."""
    rigid = find_rigid_motions(structure, interface, contact)
    rigid = np.vstack([rigid, np.zeros((count - len(contact), rigid.shape[1]))])
    force = np.abs(stiffness @ rigid).max(axis=0, initial=0) / np.abs(stiffness).max()
    if (force > 1e-9).any():
        raise ModesError(
            f"a rigid motion of a floating body meets elastic forces ({force.max():.2g} of the stiffness): is its mesh "
            "distorted, or so fine that rounding shows?"
        )
    return rigid


def _inner(x: np.ndarray, y: np.ndarray, comm: MPI.Comm) -> float:
    with np.errstate(over="ignore", invalid="ignore"):  # of loads too large to square, which the model refuses
        return comm.allreduce(float(x @ y))


def _sum(part: np.ndarray, comm: MPI.Comm) -> np.ndarray:
    """Sum over the ranks, the same bits on each of them."""
    return comm.bcast(comm.reduce(part))
