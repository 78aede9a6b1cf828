"""Eigenpairs of sparse matrices by SLEPc, each with its residual checked; modes that are alike in every run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from petsc4py import PETSc
from slepc4py import SLEPc

from ewr_fenicsx.errors import ModesError
from ewr_fenicsx.structure.boundaries import list_dofs
from ewr_fenicsx.structure.columns import finding_memory, multiply, use_mumps
from ewr_fenicsx.structure.elasticity import Structure, connect
from ewr_fenicsx.structure.interface import Interface
from ewr_fenicsx.structure.rigid_motions import find_free_motions

_EQUAL = 1e-7  # relative distance of frequencies up to which rounding mixes their modes
LARGEST_RESIDUAL = 1e-9  # of a mode, relative, unless rounding in ``K phi`` alone is larger


@dataclass(frozen=True)
class Modes:
    """Eigenpairs of ``K phi = omega^2 M phi``, mass-normalised, by rising frequency.

    Attributes:
        frequency: ``(m,)`` [Hz]; negative where rounding gives a rigid-body mode a negative eigenvalue.
        vectors: Distributed like the matrices.
        residual: ``|K phi - omega^2 M phi| / (s |M phi|)`` with ``s`` the larger of ``omega^2`` and its distance from
            the shift, ``(m,)``.
    """

    frequency: np.ndarray
    vectors: list[PETSc.Vec]
    residual: np.ndarray


def solve_modes(
    stiffness: PETSc.Mat,
    mass: PETSc.Mat,
    count: int,
    *,
    shift: float = 0.0,
    known: Sequence[PETSc.Vec] = (),
) -> Modes:
    """The modes with eigenvalues nearest to a shift, by shift-invert Krylov-Schur.

    Args:
        stiffness: Symmetric, sparse [N/m].
        mass: Symmetric positive definite, sparse [kg].
        count: How many.
        shift: Eigenvalue [rad^2/s^2] near which to look; a singular stiffness needs one below zero.
        known: Modes that are not looked for again.

    Raises:
        ModesError: Fewer modes than asked for, a residual above ``LARGEST_RESIDUAL``, or a singular stiffness with no
            shift.
        MemoryError: The factors do not fit into memory.
    """
    size = stiffness.getSize()[0]
    if not 0 < count <= size - len(known):
        besides = f" besides {len(known)}" if known else ""
        raise ModesError(
            f"{count} modes asked for{besides}; the matrices have {size} degrees of freedom, "
            f"give 1 to {size - len(known)}"
        )
    solver = SLEPc.EPS().create(stiffness.comm)
    solver.setOperators(stiffness, mass)
    solver.setProblemType(SLEPc.EPS.ProblemType.GHEP)
    solver.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    solver.setTarget(shift)
    solver.setTolerances(1e-2 * LARGEST_RESIDUAL, 300)
    transform = solver.getST()
    transform.setType(SLEPc.ST.Type.SINVERT)
    use_mumps(transform.getKSP())
    vectors = _find_nearest(solver, count, shift, known)
    modes, rounding = _measure_modes(stiffness, mass, vectors, shift)
    # in fine meshes the forces that cancel in K phi are so large that their rounding alone passes any fixed tolerance
    if np.any(modes.residual > np.maximum(LARGEST_RESIDUAL, rounding)):
        with suppress(np.linalg.LinAlgError):  # a singular stiffness makes all of them one, which is told below
            vectors = _iterate_once(transform.getKSP(), mass, vectors, known)
            modes, rounding = _measure_modes(stiffness, mass, vectors, shift)
    solver.destroy()
    if max(rounding) > 0.01:
        raise ModesError(
            f"mode {np.argmax(rounding) + 1} is lost in rounding, too close to sigma = {shift:g} rad^2/s^2: a body "
            "floats and the stiffness is singular, one is very slender, or one is far softer than another; clamp the "
            "body (in Python: or give a shift below zero), take fewer cells across the slender one or make it "
            "thicker, or see the Young's moduli [Pa]"
        )
    excess = modes.residual / np.maximum(LARGEST_RESIDUAL, rounding)
    worst = int(np.argmax(excess))
    if not excess[worst] <= 1:
        raise ModesError(
            f"mode {worst + 1} at {modes.frequency[worst]:.6g} Hz has a relative residual of "
            f"{modes.residual[worst]:.2g}, allowed is {max(LARGEST_RESIDUAL, rounding[worst]):.2g}; "
            "ask for fewer modes"
        )
    return modes


def _find_nearest(solver: SLEPc.EPS, count: int, shift: float, known: Sequence[PETSc.Vec]) -> list[PETSc.Vec]:
    """Vectors of the modes nearest to a shift, by rising eigenvalue.

    Of modes that share a frequency, as of parts that are alike, Krylov's method sees one, and the others by rounding
    alone, at times after modes further off. So those found are counted; where some are missing, it looks again beside
    those found, until nothing nearer turns up.
    """
    stiffness, mass = solver.getOperators()
    size = stiffness.getSize()[0] - len(known)
    of_known = [vector.dot(stiffness * vector) / vector.dot(mass * vector) for vector in known]
    values, vectors, asked, farthest = np.zeros(0), [], count, np.inf
    while True:
        left = size - len(vectors)
        columns = min(left, max(2 * asked, asked + 20))
        further, others = _search(solver, asked, columns, shift, [*known, *vectors])
        if not np.any(np.abs(further - shift) < (1 - _EQUAL) * farthest):
            break
        looked_again = bool(vectors)
        values, vectors = np.append(values, further), vectors + others
        distance = np.sort(np.abs(values - shift))
        farthest = distance[count - 1]
        within = max(distance[count - 1 : count + 1].mean(), (1 + _EQUAL) * farthest)  # midway to the next one
        there = np.sum(np.abs(np.append(values, of_known) - shift) < within)
        if columns == left or there == _count_modes(stiffness, mass, shift, within):
            break
        asked = max(1, min(2 * asked, (left - len(others)) // 2)) if looked_again else 1
    nearest = np.argsort(np.abs(values - shift), kind="stable")[:count]
    return [vectors[k] for k in nearest[np.argsort(values[nearest], kind="stable")]]


def _count_modes(stiffness: PETSc.Mat, mass: PETSc.Mat, shift: float, within: float) -> int:
    """Number of modes with eigenvalues within a distance of a shift.

    By Sylvester's law of inertia as many are below ``mu`` as ``K - mu M`` has negative pivots.
    """
    ends = [shift - within, shift + within] if shift > 0 else [shift + within]  # none is below zero
    below = []
    for end in ends:
        shifted = stiffness.copy()
        shifted.axpy(-end, mass)
        shifted.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        solver = PETSc.PC().create(stiffness.comm)
        solver.setOperators(shifted)
        solver.setType(PETSc.PC.Type.CHOLESKY)
        solver.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
        solver.setFactorSetUpSolverType()
        for option in (13, 24):  # on ranks count all pivots, and those that are zero
            solver.getFactorMatrix().setMumpsIcntl(option, 1)
        with finding_memory(stiffness.getSize()[0]):
            solver.setUp()
        below.append(solver.getFactorMatrix().getInertia()[0])
        solver.destroy()
        shifted.destroy()
    return below[-1] - sum(below[:-1])


def _search(
    solver: SLEPc.EPS, count: int, columns: int, shift: float, beside: Sequence[PETSc.Vec]
) -> tuple[np.ndarray, list[PETSc.Vec]]:
    """Eigenvalues and vectors that converge in a Krylov space of so many columns, beside some modes: ``count`` or more.

    Raises:
        ModesError: Fewer, or a singular stiffness with no shift.
        MemoryError: As ``solve_modes``.
    """
    stiffness, size = solver.getOperators()[0], solver.getOperators()[0].getSize()[0]
    solver.setDimensions(count, columns)
    if beside:
        solver.setDeflationSpace(list(beside))
    try:
        with finding_memory(size):
            solver.solve()
    except PETSc.Error as error:
        raise ModesError(
            f"cannot factorise K - sigma M at sigma = {shift:g} rad^2/s^2: is the stiffness singular (a body "
            "that floats) with a shift of zero?"
        ) from error
    found = solver.getConverged()
    if found < count:
        raise ModesError(
            f"{found} of {count} modes converged near sigma = {shift:g} rad^2/s^2 in {size} degrees of "
            "freedom; ask for fewer"
        )
    vectors = [stiffness.createVecRight() for _ in range(found)]
    for k, vector in enumerate(vectors):
        solver.getEigenvector(k, vector)
    return np.array([solver.getEigenvalue(k).real for k in range(found)]), vectors


def full_stick_modes(structure: Structure, interface: Interface, count: int) -> Modes:
    """Modes of the whole joint with every pair bonded, between its supports; vectors on all degrees of freedom.

    The rigid-body modes of what supports leave free, even through the joint, come first.

    Raises:
        ModesError: As ``solve_modes``.
    """
    tie = tie_pairs(structure, interface)
    stiffness, mass = structure.stiffness.ptap(tie), structure.mass.ptap(tie)
    part = structure.part
    bonded = connect(part[interface.nodes_a], part[interface.nodes_b], part.max() + 1)[part]
    floats = any(find_free_motions(structure, bonded == group).size for group in np.unique(bonded))
    # far below the mean eigenvalue, which is near the highest, yet far enough from zero to factorise
    shift = -1e-6 * stiffness.getDiagonal().sum() / mass.getDiagonal().sum() if floats else 0.0
    modes = solve_modes(stiffness, mass, count, shift=shift)
    vectors = []
    for reduced in modes.vectors:
        full = structure.mass.createVecLeft()
        tie.mult(reduced, full)
        vectors.append(full)
    return Modes(modes.frequency, vectors, modes.residual)


def group_equal(frequency: np.ndarray, known: np.ndarray | None = None) -> list[np.ndarray]:
    """Places of modes that share a frequency with others, group by group.

    Args:
        frequency: ``(m,)`` [Hz], rising.
        known: ``(m,)``, which modes stay as they are and are in no group; None: none.
    """
    places = np.arange(len(frequency)) if known is None else np.flatnonzero(~known)
    wide = np.diff(frequency[places]) > _EQUAL * np.abs(frequency[places][1:])
    return [group for group in np.split(places, np.flatnonzero(wide) + 1) if len(group) > 1]


def orient_modes(basis: np.ndarray, contacts: int, groups: list[np.ndarray], mass: PETSc.Mat) -> None:
    """Turns the modes in a basis by their inertial coupling with the contact nodes, whatever the numbering; collective.

    A mode by itself has a positive one with a pattern of the contact nodes' motion. Of m modes that share a
    frequency, any orthogonal mixture is as good: the second one has none with the first pattern, and so on.

    Args:
        basis: This rank's rows ``(rows, n)``; its modes are changed.
        contacts: Number of its first columns, which are no modes.
        groups: Places of modes that share a frequency, counted from the first mode.
        mass: Of all rows.
    """
    modes = basis[:, contacts:]
    phase = np.outer(np.arange(1, contacts + 1), np.arange(1, 1 + max(map(len, groups), default=1)))
    # weights that no symmetry of a geometry makes cancel
    inertia = multiply(mass, basis[:, :contacts] @ np.cos(phase))
    coupling = mass.comm.tompi4py().allreduce(modes.T @ inertia)
    signs = np.where(coupling[:, 0] < 0, -1.0, 1.0)
    for group in groups:
        mixture, triangle = np.linalg.qr(coupling[group, : len(group)])
        modes[:, group] = modes[:, group] @ mixture
        signs[group] = np.where(np.diag(triangle) < 0, -1.0, 1.0)
    modes *= signs


def tie_pairs(structure: Structure, interface: Interface) -> PETSc.Mat:
    """Sparse ``T`` with ``u = T y``: both nodes of each pair move as one and what is held does not move."""
    comm = structure.mass.comm.tompi4py()
    first, last = structure.mass.getOwnershipRange()
    sides = interface.nodes_b, interface.nodes_a
    follower, leader = (list_dofs(nodes, structure.mesh.dimension).ravel() for nodes in sides)
    # a pair with one held node is held
    held = np.union1d(structure.fixed, leader[np.isin(follower, structure.fixed)])
    kept = np.setdiff1d(np.arange(first, last), np.concatenate([held, follower]))
    start = comm.exscan(len(kept)) or 0
    columns = np.concatenate(comm.allgather(kept))  # rising
    tie = PETSc.Mat().createAIJ(((last - first, None), (len(kept), None)), nnz=1, comm=structure.mass.comm)
    for k, row in enumerate(kept):
        tie.setValue(row, start + k, 1.0)
    for row, to in zip(follower, leader, strict=True):
        if first <= row < last and not np.isin(to, held):
            tie.setValue(row, np.searchsorted(columns, to), 1.0)
    tie.assemble()
    return tie


def _measure_modes(
    stiffness: PETSc.Mat, mass: PETSc.Mat, vectors: Sequence[PETSc.Vec], shift: float
) -> tuple[Modes, np.ndarray]:
    """The modes of vectors, which are normalised, and the rounding in their residuals ``(m,)``."""
    pairs = [_normalise(stiffness, mass, vector, shift) for vector in vectors]
    frequency, vectors, residual, rounding = zip(*pairs, strict=True)
    return Modes(np.array(frequency), list(vectors), np.array(residual)), np.array(rounding)


def _iterate_once(
    factors: PETSc.KSP, mass: PETSc.Mat, vectors: Sequence[PETSc.Vec], known: Sequence[PETSc.Vec]
) -> list[PETSc.Vec]:
    """A step of subspace iteration on normalised modes, which takes what Krylov's method leaves of far higher ones.

    That is its rounding, large beside modes far above the lowest, as of slender bodies.

    Args:
        factors: Solves with ``K - sigma M``.
        mass: Of the structure [kg].
        vectors: Normalised modes.
        known: Modes that are not among them.
    """
    before, after = [mass * vector for vector in vectors], []
    for inertia in before:
        after.append(inertia.duplicate())
        factors.solve(inertia, after[-1])
        for mode in known:
            other = mass * mode
            after[-1].axpy(-after[-1].dot(other) / mode.dot(other), mode)
    for inertia, vector in zip(before, after, strict=True):
        scale = 1 / math.sqrt(vector.dot(mass * vector))
        inertia.scale(scale)
        vector.scale(scale)
    inertias = [mass * vector for vector in after]
    shifted, gram = (np.array([[vector.dot(f) for f in forces] for vector in after]) for forces in (before, inertias))
    _, combinations = scipy.linalg.eigh((shifted + shifted.T) / 2, (gram + gram.T) / 2)
    mixed = []
    for combination in combinations.T:
        mixed.append(after[0].duplicate())
        mixed[-1].set(0.0)
        mixed[-1].maxpy(combination, after)
    return mixed


def _normalise(
    stiffness: PETSc.Mat, mass: PETSc.Mat, vector: PETSc.Vec, shift: float
) -> tuple[float, PETSc.Vec, float, float]:
    """Frequency [Hz] by the Rayleigh quotient, mass-normalised vector, relative residual, and its rounding."""
    inertia = mass * vector
    scale = 1 / math.sqrt(vector.dot(inertia))
    vector.scale(scale)
    inertia.scale(scale)
    force = stiffness * vector
    value = vector.dot(force)
    force.axpy(-value, inertia)
    size = max(abs(value), abs(value - shift)) * inertia.norm()
    rounding = np.finfo(float).eps * stiffness.norm(PETSc.NormType.INFINITY) * vector.norm() / size
    return math.copysign(math.sqrt(abs(value)), value) / (2 * math.pi), vector, force.norm() / size, rounding
