"""Linear elasticity, plane or solid: meshes become sparse mass, stiffness and damping matrices, loads and output rows.

No boundary condition is built into the matrices: the degrees of freedom that supports hold are listed, and whoever
solves leaves them out. In ``d`` dimensions the scalar degree of freedom ``d k + c`` is component ``c`` of node ``k`` of
the space.
"""

from __future__ import annotations

import cmath
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import dolfinx
import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
import ufl
from mpi4py import MPI
from petsc4py import PETSc

from ewr_fenicsx.errors import MeshError, SceneError, nearest
from ewr_fenicsx.structure import _compat
from ewr_fenicsx.structure.boundaries import (
    boundary_facets,
    find_idle_corners,
    find_tag,
    list_dofs,
    local_to_global,
    mean_over_boundary,
    outer_facets,
)
from ewr_fenicsx.structure.materials import Damping, Material, PerMode, Rayleigh, RayleighRatios
from ewr_fenicsx.structure.mesh import JointMesh

UNDAMPED = Rayleigh()
NO_AXES: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class BoundaryForce:
    """A force spread evenly over a named boundary.

    Attributes:
        name: For messages and files.
        boundary: Its physical name.
        force: Resultant ``(F_x, F_y)``, of solids ``(F_x, F_y, F_z)`` [N].
        harmonic: 0 for a static force.
        phase: Of the force, ``Re F exp(i (h tau + phase))`` [rad].

    Raises:
        SceneError: A harmonic that is no whole number from 0, or a static force with a phase.
    """

    name: str
    boundary: str
    force: tuple[float, ...]
    harmonic: int = 0
    phase: float = 0.0

    def __post_init__(self) -> None:
        if self.harmonic < 0 or self.harmonic != int(self.harmonic):
            raise SceneError(f'load "{self.name}": harmonic is {self.harmonic}; give 0 (static), 1, 2, ...')
        if self.harmonic == 0 and self.phase != 0:
            raise SceneError(f'load "{self.name}": a static load has no phase, it is {self.phase} rad; give harmonic 1')


@dataclass(frozen=True)
class CentrifugalForce:
    """The static body force ``rho omega^2 r`` of a rotation, where ``r`` leads from the axis to a point, the short way.

    Attributes:
        name: For messages and files.
        omega: Rotation speed [rad/s].
        centre: Where the axis meets the plane; of solids any point of it [m].
        axis: Direction of the axis; its length does not matter. That of a plane is normal to it.

    Raises:
        SceneError: An axis without direction.
    """

    name: str
    omega: float
    centre: tuple[float, ...]
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    harmonic: int = field(default=0, init=False)
    phase: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        if not any(self.axis):
            raise SceneError(f'load "{self.name}": axis is {self.axis}; give a vector other than zero')


LoadSpec = BoundaryForce | CentrifugalForce


@dataclass(frozen=True)
class OutputSpec:
    """The mean displacement of a named boundary along a direction (normalised here)."""

    name: str
    boundary: str
    direction: tuple[float, ...]


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
        space: Displacement space, a block a node.
        thickness: Out of plane [m]; of solids 1.
        mass: Sparse [kg].
        stiffness: Sparse [N/m].
        rayleigh: Coefficients of the damping matrix; zero where damping is per mode.
        fixed_dofs: Global numbers of the held degrees of freedom that this rank owns, sorted.
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
        cells = np.arange(self.mesh.domain.topology.index_map(self.mesh.dimension).size_local)
        nodes = local_to_global(space, _compat.cell_dofs(space, cells)).reshape(len(cells), -1)
        return number_connected(nodes, count, comm)

    @cached_property
    def idle_corners(self) -> np.ndarray:
        """Local numbers of nodes that carry nothing of an even pressure, as ``find_idle_corners`` has them."""
        return find_idle_corners(self.space)

    @cached_property
    def fixed(self) -> np.ndarray:
        """Global numbers of all held degrees of freedom, rising, the same on every rank; collective on first use."""
        return np.concatenate(self.mass.comm.tompi4py().allgather(self.fixed_dofs))

    @cached_property
    def fixed_places(self) -> np.ndarray:
        """Where those are, ``(n, d)`` [m]; collective on first use."""
        comm, d = self.mass.comm.tompi4py(), self.mesh.dimension
        first = self.mass.getOwnershipRange()[0]
        mine = self.space.tabulate_dof_coordinates()[(self.fixed_dofs - first) // d, :d]
        return np.concatenate(comm.allgather(mine))


def connect(one: np.ndarray, other: np.ndarray, count: int) -> np.ndarray:
    """Connected component of each of ``count`` nodes ``(count,)``, by pairs of nodes that are joined."""
    graph = scipy.sparse.coo_matrix((np.ones(len(one)), (one, other)), shape=(count, count))
    return scipy.sparse.csgraph.connected_components(graph, directed=False)[1]


def number_connected(of_cells: np.ndarray, count: int, comm: MPI.Comm) -> np.ndarray:
    """Connected component of each of ``count`` nodes or facets ``(count,)``, alike on all ranks; collective.

    Args:
        of_cells: Global numbers of those of this rank's cells, which join them, ``(cells, k)``.
        count: How many there are.
        comm: All its ranks must call.
    """
    first = np.broadcast_to(of_cells[:, :1], of_cells.shape).ravel()
    mine, here = connect(first, of_cells.ravel(), count), np.unique(of_cells)
    leader = np.unique(mine, return_index=True)[1][mine]
    links = np.concatenate(comm.allgather(np.stack([here, leader[here]], axis=1)))
    return connect(*links.T, count)


def assemble_structure(
    mesh: JointMesh,
    *,
    materials: Mapping[str, Material],
    thickness: float = 0.01,
    plane: str = "stress",
    degree: int = 1,
    clamp: Sequence[str] = ("clamp",),
    hold: Mapping[str, str] = NO_AXES,
    damping: Damping = UNDAMPED,
    loads: Sequence[LoadSpec] = (),
    outputs: Sequence[OutputSpec] = (),
) -> Structure:
    """Assembles matrices, loads and output rows.

    Args:
        mesh: Bodies and boundaries.
        materials: Body name -> material; every body needs one.
        thickness: Out of plane [m]; solids have none.
        plane: "stress" or "strain"; no matter to solids.
        degree: Of the Lagrange elements, 1 or 2.
        clamp: Names of the boundaries held in all directions; may be empty.
        hold: Boundary -> axes along which it is held, such as "z" or "xy".
        damping: How D is made.
        loads: Forces.
        outputs: Displacements to follow.

    Raises:
        MeshError: A mesh whose cells are of a higher order than the elements; a name that is no body or boundary of
            it; a boundary with no facet; one of a load or an output that is inside, or a flank.
        SceneError: A value out of its range, a vector of another dimension than the mesh, a body without material.
        EwrError: The forms cannot be compiled.
    """
    _check_choices(mesh, materials, thickness, plane, degree)
    _check_vectors(mesh.dimension, loads, outputs)
    _check_axes(mesh.dimension, hold)
    thickness = thickness if mesh.dimension == 2 else 1.0
    space = _compat.function_space(mesh.domain, "Lagrange", degree, (mesh.dimension,))
    density, shear, lame = _material_fields(mesh, materials, plane)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    # 2 p + 1 integrates the mass of straight-sided elements exactly, however skewed
    dx = ufl.Measure("dx", domain=mesh.domain, metadata={"quadrature_degree": 2 * degree + 1})
    strain = ufl.sym(ufl.grad(u))
    stress = 2 * shear * strain + lame * ufl.tr(strain) * ufl.Identity(mesh.dimension)
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
        fixed_dofs=_fixed_dofs(mesh, space, dict.fromkeys(clamp, "xyz") | dict(hold)),
        loads=tuple(_assemble_load(mesh, space, load, density, thickness, dx) for load in loads),
        outputs={
            o.name: mean_over_boundary(space, outer_facets(mesh, "output", o.name, o.boundary), _unit(o))
            for o in outputs
        },
        modal_damping=damping.ratio if isinstance(damping, PerMode) else None,
    )


def _check_choices(
    mesh: JointMesh, materials: Mapping[str, Material], thickness: float, plane: str, degree: int
) -> None:
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
        find_tag(mesh.bodies, body, "body")
    for body in mesh.bodies:
        if body not in materials:
            raise SceneError(f'materials: body "{body}" has none; give it one (there are {", ".join(materials)})')


def _check_vectors(dimension: int, loads: Sequence[LoadSpec], outputs: Sequence[OutputSpec]) -> None:
    vectors = {f"outputs.{output.name}.direction": output.direction for output in outputs}
    for load in loads:
        kind = "force" if isinstance(load, BoundaryForce) else "centre"
        vectors[f"loads.{load.name}.{kind}"] = getattr(load, kind)
        if dimension == 2 and kind == "centre" and any(load.axis[:2]):
            raise SceneError(f"loads.{load.name}.axis = {list(load.axis)}: a plane turns about an axis normal to it")
    for what, vector in vectors.items():
        if len(vector) != dimension:
            raise SceneError(f"{what} = {list(vector)}: the mesh is {dimension}-D; give {dimension} components")


def _check_axes(dimension: int, hold: Mapping[str, str]) -> None:
    known = "xyz"[:dimension]
    for name, axes in hold.items():
        if not axes or set(axes) - set(known):
            raise SceneError(
                f'supports.hold.{name} = "{axes}": the mesh is {dimension}-D; give one or more of {", ".join(known)}'
            )


def body_nodes(structure: Structure, body: str) -> np.ndarray:
    """Global node numbers of a body that this rank owns, sorted.

    Raises:
        MeshError: No such body.
    """
    space, mesh = structure.space, structure.mesh
    cells = mesh.cell_tags.find(find_tag(mesh.bodies, body, "body"))
    # a node that a rank owns may touch this body through cells of another rank only: sum the marks on the owner
    marks = structure.mass.createVecRight()
    nodes = local_to_global(space, np.unique(_compat.cell_dofs(space, cells)))
    first = mesh.dimension * nodes.astype(np.int32)
    marks.setValues(first, np.ones(len(nodes)), addv=PETSc.InsertMode.ADD_VALUES)
    marks.assemble()
    start = marks.getOwnershipRange()[0]
    return (start + np.flatnonzero(marks.array > 0.5)) // mesh.dimension


def _material_fields(mesh: JointMesh, materials: Mapping[str, Material], plane: str) -> tuple:
    """Density, shear modulus and first Lame parameter (of plane stress where that rules), constant in each cell."""
    constants = _compat.function_space(mesh.domain, "DG", 0)
    fields = tuple(dolfinx.fem.Function(constants) for _ in range(3))
    covered, all_cells = 0, mesh.domain.topology.index_map(mesh.dimension)
    for body, material in materials.items():
        cells = mesh.cell_tags.find(mesh.bodies[body])
        owned = cells[cells < all_cells.size_local]
        covered += mesh.domain.comm.allreduce(len(owned))
        shear = material.young / (2 * (1 + material.poisson))
        lame = 2 * shear * material.poisson / (1 - 2 * material.poisson)
        if mesh.dimension == 2 and plane == "stress":  # none normal to the plane
            lame = 2 * shear * lame / (lame + 2 * shear)
        dofs = _compat.cell_dofs(constants, cells)
        for function, value in zip(fields, (material.density, shear, lame), strict=True):
            function.x.array[dofs] = value
    if covered != (total := all_cells.size_global):
        raise MeshError(
            f"{total - covered} of {total} cells belong to no body ({', '.join(mesh.bodies)}); "
            f"give every {'surface' if mesh.dimension == 2 else 'volume'} a physical group"
        )
    return fields


def _assemble_load(mesh: JointMesh, space, load: LoadSpec, density, thickness: float, dx) -> Load:
    if isinstance(load, BoundaryForce):
        forces = mean_over_boundary(space, outer_facets(mesh, "load", load.name, load.boundary), load.force)
    else:
        along = np.array(load.axis) / np.linalg.norm(load.axis)
        across = (np.eye(3) - np.outer(along, along))[: mesh.dimension, : mesh.dimension]
        centre, across = (
            dolfinx.fem.Constant(mesh.domain, np.array(c, PETSc.ScalarType)) for c in (load.centre, across)
        )
        radius = ufl.dot(across, ufl.SpatialCoordinate(mesh.domain) - centre)
        form = density * ufl.inner(radius, ufl.TestFunction(space)) * dx
        forces = _compat.assemble_vector(_compat.compile_form(form, "the centrifugal force"))
        forces.scale(thickness * load.omega**2)
    return Load(load.name, load.harmonic, cmath.exp(1j * load.phase), forces)


def _fixed_dofs(mesh: JointMesh, space, held: Mapping[str, str]) -> np.ndarray:
    """Those of boundaries that are held along some axes each, of this rank, sorted."""
    dofs = [np.empty(0, dtype=np.int64)]
    for name, axes in held.items():
        found = dolfinx.fem.locate_dofs_topological(space, mesh.dimension - 1, boundary_facets(mesh, name))
        nodes = local_to_global(space, found[found < space.dofmap.index_map.size_local])
        dofs.append(list_dofs(nodes, mesh.dimension)[:, [axis in axes for axis in "xyz"[: mesh.dimension]]].ravel())
    return np.unique(np.concatenate(dofs))


def _unit(output: OutputSpec) -> np.ndarray:
    length = float(np.linalg.norm(output.direction))
    if length == 0:
        raise SceneError(f'output "{output.name}": direction is {output.direction}; give a vector other than zero')
    return np.array(output.direction) / length
