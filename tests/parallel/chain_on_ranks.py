"""Builds the two-block joint and its reduced model on all ranks; rank 0 writes what must not depend on their number."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

from ewr_fenicsx.structure.elasticity import BoundaryForce, CentrifugalForce, OutputSpec, assemble_structure
from ewr_fenicsx.structure.interface import pair_interface
from ewr_fenicsx.structure.materials import TITANIUM, RayleighRatios
from ewr_fenicsx.structure.mesh import build_mesh
from ewr_fenicsx.structure.reduction import reduce_structure

comm = MPI.COMM_WORLD
source, parameters, degree, target = Path(sys.argv[1]), json.loads(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4])
mesh = build_mesh(source, parameters, comm)
structure = assemble_structure(
    mesh,
    materials=dict.fromkeys(mesh.bodies, TITANIUM),
    degree=degree,
    damping=RayleighRatios((500.0, 3000.0), (0.002, 0.002)),
    loads=[
        BoundaryForce("pull", "tip", (50.0, 1000.0)),
        CentrifugalForce("spin", 300.0, (0.0, -0.2)),
        BoundaryForce("push", "tip", (10.0, 2.0), 1),
    ],
    outputs=[OutputSpec("tip", "tip", (1.0, 0.0))],
)
interface = pair_interface(structure)
reduction = reduce_structure(structure, interface, modes=12)
model = reduction.model

rows = np.vstack([model.normal, model.tangential])
forces = np.column_stack([rows.T, model.load[0], model.load[1]])
compliance = []
for omega in 2 * np.pi * np.array([300.0, 1500.0, 4000.0]):
    dynamic = model.stiffness + 1j * omega * model.damping - omega**2 * model.mass
    compliance.append(np.vstack([rows, model.outputs["tip"]]) @ np.linalg.solve(dynamic, forces))
# the static field of the bonded joint, expanded: its work on the mesh is the work of the load
_, values, basis = np.linalg.svd(rows)
bonded = basis[len(values) :].T
x = bonded @ np.linalg.solve(bonded.T @ model.stiffness @ bonded, bonded.T @ model.load[0].real)
field = reduction.expand(x)
owned = structure.mass.createVecRight()
owned.array[:] = field.x.array[: owned.getLocalSize()]
energy = owned.dot(structure.stiffness * owned)

bodies = [
    sum(comm.allgather(int((mesh.cell_tags.find(tag) < mesh.domain.topology.index_map(2).size_local).sum())))
    for tag in mesh.bodies.values()
]
mine = [
    bool((mesh.cell_tags.find(tag) < mesh.domain.topology.index_map(2).size_local).any())
    for tag in mesh.bodies.values()
]
same = {
    name: len({getattr(model, name).tobytes() for model in comm.allgather(model)}) == 1
    for name in ("mass", "damping", "stiffness", "normal", "tangential", "rigid_modes")
}
pairs = comm.allgather((interface.nodes_a.tobytes(), interface.area.tobytes(), interface.position.tobytes()))
bodies_on_rank = comm.allgather(mine)
if comm.rank == 0:
    np.savez(
        target,
        compliance=compliance,
        position=interface.position,
        area=interface.area,
        normal=interface.normal,
        fixed=reduction.fixed_interface_frequencies,
        stick=reduction.full_stick.frequency,
        tip=model.outputs["tip"] @ x,
        energy=energy,
        work=model.load[0].real @ x,
        rigid=np.abs(model.stiffness @ model.rigid_modes) / (np.abs(model.stiffness) @ np.abs(model.rigid_modes)).max(),
        cells=bodies,
        bodies_on_rank=bodies_on_rank,
        stiffness=model.stiffness,
        mass=model.mass,
        pairs_agree=len(set(pairs)) == 1,
        models_agree=all(same.values()),
    )
