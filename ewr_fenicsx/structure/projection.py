"""Projection on the basis of the reduction: sparse matrices, loads and outputs become a ``ReducedModel``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg
from mpi4py import MPI

from ewr_fenicsx.errors import ModesError
from ewr_fenicsx.model.reduced_model import ReducedModel
from ewr_fenicsx.model.restriction import solve_stuck
from ewr_fenicsx.model.ring import close_ring
from ewr_fenicsx.structure.columns import blocks, multiply
from ewr_fenicsx.structure.elasticity import Structure
from ewr_fenicsx.structure.interface import Interface
from ewr_fenicsx.structure.rigid_motions import find_rigid_motions
from ewr_fenicsx.structure.sector_cuts import SectorCuts, list_boundary


def project(
    structure: Structure, interface: Interface, basis: np.ndarray, contact: np.ndarray, cuts: SectorCuts | None
) -> ReducedModel:
    """The reduced model on a basis whose first columns are the boundary's degrees of freedom; of a sector, closed.

    Args:
        structure: What is reduced.
        interface: The pairs.
        basis: This rank's rows of the basis.
        contact: Numbers of the degrees of freedom in contact, ``(n_c,)``.
        cuts: Of a sector of a ring, or None.

    Raises:
        ModesError: A rigid motion of a body that is not free of elastic forces.
    """
    comm = structure.mass.comm.tompi4py()
    count, contacts = basis.shape[1], len(contact)

    def rows(operator) -> np.ndarray:
        return np.hstack([operator[:, contact].toarray(), np.zeros((operator.shape[0], count - contacts))])

    mass = _project_mass(structure, basis)
    stiffness = _project_stiffness(structure, basis, list_boundary(contact, cuts))
    damping = structure.rayleigh.alpha * mass + structure.rayleigh.beta * stiffness
    normal, tangential = rows(interface.normal_gap), rows(interface.tangential_slip)
    load: dict[int, np.ndarray] = {}
    for entry in structure.loads:
        amplitude = entry.amplitude * _sum(basis.T @ entry.vector.array, comm)
        load[entry.harmonic] = load.get(entry.harmonic, 0) + amplitude
    outputs = {name: _sum(basis.T @ row.array, comm) for name, row in structure.outputs.items()}
    rigid = _rigid_motions(structure, interface, contact, count, stiffness)
    model = ReducedModel(mass, damping, stiffness, normal, tangential, load, interface.area, rigid, outputs)
    if structure.modal_damping is not None:
        model = replace(model, damping=_damp_modes(model, structure.modal_damping))
    if cuts is None:
        return model
    low, ring = np.arange(contacts, contacts + len(cuts.low)), cuts.ring
    further = {"normal": interface.next_normal_gap, "tangential": interface.next_tangential_slip}
    return close_ring(
        model,
        low,
        low + len(low),
        sectors=ring.sectors,
        engine_order=ring.engine_order,
        turn=cuts.turn,
        **{name: None if operator is None else rows(operator) for name, operator in further.items()},
    )


def _project_mass(structure: Structure, basis: np.ndarray) -> np.ndarray:
    count = basis.shape[1]
    lower = np.zeros((count, count))
    for block in blocks(count):
        lower[block.start :, block] = basis[:, block.start :].T @ multiply(structure.mass, basis[:, block])
    lower = np.tril(_sum(lower, structure.mass.comm.tompi4py()))
    return lower + np.tril(lower, -1).T


def _project_stiffness(structure: Structure, basis: np.ndarray, boundary: np.ndarray) -> np.ndarray:
    """The forces of constraint modes act where the other modes rest, at the boundary's degrees of freedom."""
    first, last = structure.stiffness.getOwnershipRange()
    count, bounding = basis.shape[1], len(boundary)
    mine = np.flatnonzero((boundary >= first) & (boundary < last))
    reduced = np.zeros((count, count))
    for block in blocks(bounding):
        reduced[mine, block] = multiply(structure.stiffness, basis[:, block])[boundary[mine] - first]
    others = basis[:, bounding:]
    reduced[bounding:, bounding:] = others.T @ multiply(structure.stiffness, others)
    reduced = _sum(reduced, structure.stiffness.comm.tompi4py())
    return 0.5 * (reduced + reduced.T)


def _damp_modes(model: ReducedModel, ratio: float) -> np.ndarray:
    """Damping with a ratio for each mode of the open joint, and for the modes of full stick that hold floating bodies.

    ``D = M Phi diag(2 ratio omega) Phi^T M`` with the mass-normalised modes Phi of the open joint, which span all
    motions: modes of full stick alone would leave out those that it forbids, and overdamp them where the joint opens.
    A mode of the joint held in any way then has at most this ratio, the root being concave (Jensen). Where the joint
    holds rigid motions, which are not damped, it has far less: what the lowest as many modes of full stick lack is
    added. That drags the rigid motions themselves, against the ground, and the lowest elastic modes of the open
    joint have somewhat more than the ratio.

    Args:
        model: With any damping.
        ratio: Of critical damping.
    """
    mass, floating = model.mass, model.rigid_modes.shape[1]
    values, vectors = scipy.linalg.eigh(model.stiffness, mass)
    weighted = mass @ vectors
    damping = (weighted * (2 * ratio * np.sqrt(np.maximum(values, 0)))) @ weighted.T
    if floating:
        values, shapes = (part[..., :floating] for part in solve_stuck(model))
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


def _sum(part: np.ndarray, comm: MPI.Comm) -> np.ndarray:
    """Sum over the ranks, the same bits on each of them."""
    return comm.bcast(comm.reduce(part))
