"""Plane linear elasticity: meshes become sparse mass, stiffness and damping matrices, loads and output rows.

No boundary condition is built into the matrices: the clamped degrees of freedom are listed, and whoever solves leaves
them out. Scalar degree of freedom ``2 k + c`` is component ``c`` of node ``k`` of the space.
"""

from __future__ import annotations

import cmath
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import dolfinx
import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
import ufl
from petsc4py import PETSc

from ewr_fenicsx.errors import MeshError, SceneError, nearest
from ewr_fenicsx.structure import _compat
from ewr_fenicsx.structure.facing import find_facing_bodies
from ewr_fenicsx.structure.materials import Damping, Material, PerMode, Rayleigh, RayleighRatios
from ewr_fenicsx.structure.mesh import JointMesh

UNDAMPED = Rayleigh()


@dataclass(frozen=True)
class EdgeForce:
    """A force spread evenly over a named boundary.

    Attributes:
        name: For messages and files.
        boundary: Physical name of the edge.
        force: Resultant ``(F_x, F_y)`` [N].
        harmonic: 0 for a static force.
        phase: Of the force, ``Re F exp(i (h tau + phase))`` [rad].

    Raises:
        SceneError: A harmonic that is no whole number from 0, or a static force with a phase.
    """

    name: str
    boundary: str
    force: tuple[float, float]
    harmonic: int = 0
    phase: float = 0.0

    def __post_init__(self) -> None:
        if self.harmonic < 0 or self.harmonic != int(self.harmonic):
            raise SceneError(f'load "{self.name}": harmonic is {self.harmonic}; give 0 (static), 1, 2, ...')
        if self.harmonic == 0 and self.phase != 0:
            raise SceneError(f'load "{self.name}": a static load has no phase, it is {self.phase} rad; give harmonic 1')


@dataclass(frozen=True)
class CentrifugalForce:
    """The static body force ``rho omega^2 (x - centre)`` of a rotation about an axis normal to the plane.

    Attributes:
        name: For messages and files.
        omega: Rotation speed [rad/s].
        centre: Where the axis meets the plane [m].
    """

    name: str
    omega: float
    centre: tuple[float, float]
    harmonic: int = field(default=0, init=False)
    phase: float = field(default=0.0, init=False)


LoadSpec = EdgeForce | CentrifugalForce


@dataclass(frozen=True)
class OutputSpec:
    """The mean displacement of a named boundary along a direction (normalised here)."""

    name: str
    boundary: str
    direction: tuple[float, float]


@dataclass(frozen=True)
class Load:
    """Real nodal forces ``vector`` [N] for amplitude 1 of a ``harmonic``, and the complex ``amplitude``."""

    name: str
    harmonic: int
    amplitude: complex
    vector: PETSc.Vec


@dataclass(frozen=True)
class Structure:
    """Assembled matrices of all bodies, on all degrees of freedom.

    Attributes:
        mesh: With its named bodies and boundaries.
        space: Displacement space, block size 2.
        thickness: Out of plane [m].
        mass: Sparse [kg].
        stiffness: Sparse [N/m].
        rayleigh: Coefficients of the damping matrix; zero where damping is per mode.
        fixed_dofs: Global numbers of the clamped degrees of freedom that this rank owns, sorted.
        loads: Nodal forces.
        outputs: Name -> row of the mean displacement.
        modal_damping: Ratio of critical damping a mode, applied in the reduced basis; None: ``rayleigh`` has it all.
    """

    mesh: JointMesh
    space: object
    thickness: float
    mass: PETSc.Mat
    stiffness: PETSc.Mat
    rayleigh: Rayleigh
    fixed_dofs: np.ndarray
    loads: tuple[Load, ...]
    outputs: Mapping[str, PETSc.Vec]
    modal_damping: float | None

    @property
    def damping(self) -> PETSc.Mat:
        """Sparse ``alpha M + beta K`` [N s/m], assembled anew."""
        matrix = self.mass.copy()
        matrix.scale(self.rayleigh.alpha)
        matrix.axpy(self.rayleigh.beta, self.stiffness, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        return matrix

    @cached_property
    def part(self) -> np.ndarray:
        """The part of each node, ``(all nodes,)`` from 0, the same on every rank; collective on first use.

        Nodes that cells join are of one part: bodies that share nodes are one, a body of separate pieces is several.
        """
        space, comm = self.space, self.mass.comm.tompi4py()
        count = space.dofmap.index_map.size_global
        cells = np.arange(self.mesh.domain.topology.index_map(2).size_local)
        nodes = local_to_global(space, _compat.cell_dofs(space, cells)).reshape(len(cells), -1)
        first = np.broadcast_to(nodes[:, :1], nodes.shape).ravel()
        mine, here = connect(first, nodes.ravel(), count), np.unique(nodes)
        leader = np.unique(mine, return_index=True)[1][mine]
        links = np.concatenate(comm.allgather(np.stack([here, leader[here]], axis=1)))
        return connect(*links.T, count)

    @cached_property
    def clamped(self) -> np.ndarray:
        """Global numbers of all clamped degrees of freedom, rising, the same on every rank; collective on first use."""
        return np.concatenate(self.mass.comm.tompi4py().allgather(self.fixed_dofs))


def connect(one: np.ndarray, other: np.ndarray, count: int) -> np.ndarray:
    """Connected component of each of ``count`` nodes ``(count,)``, by pairs of nodes that are joined."""
    graph = scipy.sparse.coo_matrix((np.ones(len(one)), (one, other)), shape=(count, count))
    return scipy.sparse.csgraph.connected_components(graph, directed=False)[1]


def assemble_structure(
    mesh: JointMesh,
    *,
    materials: Mapping[str, Material],
    thickness: float = 0.01,
    plane: str = "stress",
    degree: int = 1,
    clamp: Sequence[str] = ("clamp",),
    damping: Damping = UNDAMPED,
    loads: Sequence[LoadSpec] = (),
    outputs: Sequence[OutputSpec] = (),
) -> Structure:
    """Assembles matrices, loads and output rows.

    Args:
        mesh: Bodies and boundaries.
        materials: Body name -> material; every body needs one.
        thickness: Out of plane [m].
        plane: "stress" or "strain".
        degree: Of the Lagrange elements, 1 or 2.
        clamp: Names of the boundaries held in both directions; may be empty.
        damping: How D is made.
        loads: Forces.
        outputs: Displacements to follow.

    Raises:
        MeshError: A mesh that is not plane, or whose cells are of a higher order than the elements; a name that is no
            body or boundary of it; a boundary with no facet; one of a load or an output that is inside, or a flank.
        SceneError: A value out of its range, a body without material.
        EwrError: The forms cannot be compiled.
    """
    _check_choices(mesh, materials, thickness, plane, degree)
    space = _compat.function_space(mesh.domain, "Lagrange", degree, (2,))
    density, shear, lame = _material_fields(mesh, materials, plane)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    # 2 p + 1 integrates the mass of straight-sided elements exactly, however skewed
    dx = ufl.Measure("dx", domain=mesh.domain, metadata={"quadrature_degree": 2 * degree + 1})
    strain = ufl.sym(ufl.grad(u))
    stress = 2 * shear * strain + lame * ufl.tr(strain) * ufl.Identity(2)
    mass = _compat.assemble_matrix(_compat.compile_form(density * ufl.inner(u, v) * dx, "the mass form"))
    stiffness = _compat.assemble_matrix(
        _compat.compile_form(ufl.inner(stress, ufl.sym(ufl.grad(v))) * dx, "the stiffness form")
    )
    for matrix in (mass, stiffness):
        matrix.scale(thickness)

    if isinstance(damping, RayleighRatios):
        damping = damping.rayleigh()
    return Structure(
        mesh=mesh,
        space=space,
        thickness=thickness,
        mass=mass,
        stiffness=stiffness,
        rayleigh=damping if isinstance(damping, Rayleigh) else UNDAMPED,
        fixed_dofs=_clamped_dofs(mesh, space, clamp),
        loads=tuple(_assemble_load(mesh, space, load, density, thickness, dx) for load in loads),
        outputs={o.name: mean_over_edge(space, _outer_facets(mesh, o, "output"), _unit(o)) for o in outputs},
        modal_damping=damping.ratio if isinstance(damping, PerMode) else None,
    )


def _check_choices(
    mesh: JointMesh, materials: Mapping[str, Material], thickness: float, plane: str, degree: int
) -> None:
    if mesh.domain.geometry.dim != 2:
        raise MeshError(f"the mesh is {mesh.domain.geometry.dim}-dimensional; plane elasticity needs a 2-D one")
    if plane not in ("stress", "strain"):
        raise SceneError(f'plane is "{plane}"; give "stress" or "strain"{nearest(plane, ("stress", "strain"))}')
    if degree not in (1, 2):
        raise SceneError(f"degree is {degree}; give 1 or 2")
    if (order := mesh.domain.geometry.cmap.degree) > degree:
        raise MeshError(
            f"the mesh has cells of order {order} and the elements are of degree {degree}: where cells are curved, "
            f"turning a body would take forces; give elasticity.degree = {order}, or a mesh of order {degree}"
        )
    if not thickness > 0:
        raise SceneError(f"thickness is {thickness} m; give a positive number")
    for body in materials:
        _tag(mesh.bodies, body, "body")
    for body in mesh.bodies:
        if body not in materials:
            raise SceneError(f'materials: body "{body}" has none; give it one (there are {", ".join(materials)})')


def boundary_facets(mesh: JointMesh, name: str) -> np.ndarray:
    """Local numbers of a named boundary's facets, ghosts included.

    Raises:
        MeshError: No such boundary, or one without facets.
    """
    facets = mesh.facet_tags.find(_tag(mesh.boundaries, name, "boundary"))
    if mesh.domain.comm.allreduce(len(facets)) == 0:
        raise MeshError(f'boundary "{name}" has no facet; is its curve the edge of a meshed body?')
    return np.unique(facets).astype(np.int32)


def _outer_facets(mesh: JointMesh, entry: EdgeForce | OutputSpec, what: str) -> np.ndarray:
    """``boundary_facets`` of a boundary that must be no flank, nor be inside, where no edge integral sees it."""
    facets, topology = boundary_facets(mesh, entry.boundary), mesh.domain.topology
    topology.create_connectivity(1, 2)
    owned = facets[facets < topology.index_map(1).size_local]
    inside = np.setdiff1d(owned, dolfinx.mesh.exterior_facet_indices(topology))
    counts = [mesh.domain.comm.allreduce(len(f)) for f in (inside, owned)]
    if counts[0]:
        raise MeshError(
            f'boundary "{entry.boundary}": {counts[0]} of its {counts[1]} facets lie inside, with a cell on either '
            "side; a load or an output needs an edge of the bodies"
        )
    if bodies := find_facing_bodies(mesh, owned):
        each = "each would carry a part of the load" if what == "load" else "the output would be the mean over both"
        raise MeshError(
            f'{what}s.{entry.name}.boundary = "{entry.boundary}" is a flank: its curves are on both bodies, '
            f"{' and '.join(bodies)}, and {each}; name a boundary of one body"
        )
    return facets


def integrate_over_edge(space, facets: np.ndarray, direction: Sequence[float] | None = None) -> PETSc.Vec:
    """``integral N_k w ds`` over exterior facets [m]; ``w`` is a constant direction, or the outward normal (None)."""
    domain = space.mesh
    # a constant enters the compiled code as data: one compilation serves every direction
    w = (
        ufl.FacetNormal(domain)
        if direction is None
        else dolfinx.fem.Constant(domain, np.array(direction, dtype=PETSc.ScalarType))
    )
    return _integrate_field(space, facets, w)


def integrate_squared_normal(space, facets: np.ndarray) -> PETSc.Vec:
    """``integral N_k n_x n ds`` over exterior facets [m], ``n`` the outward normal."""
    n = ufl.FacetNormal(space.mesh)
    return _integrate_field(space, facets, n[0] * n)


def _integrate_field(space, facets: np.ndarray, w) -> PETSc.Vec:
    domain = space.mesh
    tags = dolfinx.mesh.meshtags(domain, domain.topology.dim - 1, facets, np.ones(len(facets), dtype=np.int32))
    ds = ufl.Measure("ds", domain=domain, subdomain_data=tags, subdomain_id=1)
    form = ufl.inner(w, ufl.TestFunction(space)) * ds
    return _compat.assemble_vector(_compat.compile_form(form, "an edge integral"))


def mean_over_edge(space, facets: np.ndarray, direction: Sequence[float]) -> PETSc.Vec:
    """Row of the mean displacement along ``direction``; also the nodal forces of that resultant spread evenly."""
    row = integrate_over_edge(space, facets, direction)
    along_x = integrate_over_edge(space, facets, (1.0, 0.0))
    row.scale(1.0 / along_x.sum())
    return row


def body_nodes(structure: Structure, body: str) -> np.ndarray:
    """Global node numbers of a body that this rank owns, sorted.

    Raises:
        MeshError: No such body.
    """
    space, mesh = structure.space, structure.mesh
    cells = mesh.cell_tags.find(_tag(mesh.bodies, body, "body"))
    # a node that a rank owns may touch this body through cells of another rank only: sum the marks on the owner
    marks = structure.mass.createVecRight()
    nodes = local_to_global(space, np.unique(_compat.cell_dofs(space, cells)))
    marks.setValues(2 * nodes.astype(np.int32), np.ones(len(nodes)), addv=PETSc.InsertMode.ADD_VALUES)
    marks.assemble()
    start = marks.getOwnershipRange()[0]
    return (start + np.flatnonzero(marks.array > 0.5)) // 2


def local_to_global(space, nodes: np.ndarray) -> np.ndarray:
    """Global node numbers of local ones (int64)."""
    return space.dofmap.index_map.local_to_global(np.asarray(nodes, dtype=np.int32)).astype(np.int64)


def _material_fields(mesh: JointMesh, materials: Mapping[str, Material], plane: str) -> tuple:
    """Density, shear modulus and the (plane) first Lame parameter, constant in each cell."""
    constants = _compat.function_space(mesh.domain, "DG", 0)
    fields = tuple(dolfinx.fem.Function(constants) for _ in range(3))
    covered = 0
    for body, material in materials.items():
        cells = mesh.cell_tags.find(mesh.bodies[body])
        owned = cells[cells < mesh.domain.topology.index_map(2).size_local]
        covered += mesh.domain.comm.allreduce(len(owned))
        shear = material.young / (2 * (1 + material.poisson))
        lame = 2 * shear * material.poisson / (1 - 2 * material.poisson)
        if plane == "stress":  # no stress normal to the plane
            lame = 2 * shear * lame / (lame + 2 * shear)
        dofs = _compat.cell_dofs(constants, cells)
        for function, value in zip(fields, (material.density, shear, lame), strict=True):
            function.x.array[dofs] = value
    total = mesh.domain.topology.index_map(2).size_global
    if covered != total:
        raise MeshError(
            f"{total - covered} of {total} cells belong to no body ({', '.join(mesh.bodies)}); "
            "give every surface a physical group"
        )
    return fields


def _assemble_load(mesh: JointMesh, space, load: LoadSpec, density, thickness: float, dx) -> Load:
    if isinstance(load, EdgeForce):
        forces = mean_over_edge(space, _outer_facets(mesh, load, "load"), load.force)
    else:
        centre = dolfinx.fem.Constant(mesh.domain, np.array(load.centre, dtype=PETSc.ScalarType))
        form = density * ufl.inner(ufl.SpatialCoordinate(mesh.domain) - centre, ufl.TestFunction(space)) * dx
        forces = _compat.assemble_vector(_compat.compile_form(form, "the centrifugal force"))
        forces.scale(thickness * load.omega**2)
    return Load(load.name, load.harmonic, cmath.exp(1j * load.phase), forces)


def _clamped_dofs(mesh: JointMesh, space, clamp: Iterable[str]) -> np.ndarray:
    nodes = [np.empty(0, dtype=np.int64)]
    for name in clamp:
        found = dolfinx.fem.locate_dofs_topological(space, mesh.domain.topology.dim - 1, boundary_facets(mesh, name))
        nodes.append(local_to_global(space, found[found < space.dofmap.index_map.size_local]))
    dofs = 2 * np.unique(np.concatenate(nodes))
    return np.sort(np.concatenate([dofs, dofs + 1]))


def _tag(known: Mapping[str, int], name: str, kind: str) -> int:
    if name not in known:
        raise MeshError(
            f'no {kind} named "{name}" in the mesh; there are {", ".join(known) or "none"}{nearest(name, known)}'
        )
    return known[name]


def _unit(output: OutputSpec) -> np.ndarray:
    length = float(np.hypot(*output.direction))
    if length == 0:
        raise SceneError(f'output "{output.name}": direction is {output.direction}; give a vector other than zero')
    return np.array(output.direction) / length
