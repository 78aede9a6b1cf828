"""From a geometry builder or a gmsh file to a distributed mesh whose bodies and boundaries carry their names.

A builder is a Python file with ``build(*, parameter: type = default, ...) -> None``: it adds geometry, mesh and
physical groups to the current gmsh model (``geometry/fir_tree.py`` is one), and may import files beside it. gmsh runs
on rank 0 alone. All checks come before dolfinx sees the model: dolfinx 0.5 ends with a segmentation fault on a mesh of
triangles and quadrilaterals.
"""

from __future__ import annotations

import importlib.machinery
import importlib.util
import inspect
import math
import sys
import typing
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import dolfinx
import gmsh
import numpy as np
from mpi4py import MPI

from ewr_fenicsx.errors import MeshError, nearest
from ewr_fenicsx.scene.scene_sense import hint_at_lengths
from ewr_fenicsx.structure import _compat

MODEL_NAME = "ewr_fenicsx"
MOST_CELLS = 1e6  # in the box around a geometry; more take long, and nobody means them

# The corners next to each corner, turned so that an uninverted cell gives positive determinants, and the determinant
# of unit edges in the ideal cell.
_CORNERS = {
    "triangle": ([(1, 2), (2, 0), (0, 1)], math.sqrt(3) / 2),
    "quadrilateral": ([(1, 3), (2, 0), (3, 1), (0, 2)], 1.0),
    "tetrahedron": ([(1, 2, 3), (2, 0, 3), (0, 1, 3), (0, 2, 1)], math.sqrt(2) / 2),
    "hexahedron": ([(1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7), (7, 5, 0), (4, 6, 1), (5, 7, 2), (6, 4, 3)], 1.0),
}
_COMPLETE = (2, 3, 4, 5, 9, 10, 11, 12)  # numbers of these in gmsh, of first order and with all nodes of second order
_CELL_NAMES = {(2, 3): "triangle", (2, 4): "quadrilateral", (3, 4): "tetrahedron", (3, 8): "hexahedron"}


@dataclass(frozen=True)
class JointMesh:
    """A mesh of the bodies of a joint, distributed over the ranks.

    Attributes:
        domain: The mesh, coordinates in m.
        cell_tags: Body of every cell.
        facet_tags: Boundary of every facet that has one.
        bodies: Name of each body and its cell tag.
        boundaries: Name of each boundary (flanks, clamp, tip) and its facet tag.
        smallest_scaled_jacobian: Over all cells and corners: 1 for a square, 0 for a degenerate cell.
    """

    domain: dolfinx.mesh.Mesh
    cell_tags: typing.Any
    facet_tags: typing.Any
    bodies: Mapping[str, int]
    boundaries: Mapping[str, int]
    smallest_scaled_jacobian: float

    @property
    def dimension(self) -> int:
        """2 of a plane mesh, 3 of solids."""
        return self.domain.topology.dim


@dataclass(frozen=True)
class _Inspection:
    """What rank 0 tells the others about the checked gmsh model."""

    dimension: int
    bodies: dict[str, int]
    boundaries: dict[str, int]
    smallest_scaled_jacobian: float


def measure_extent(mesh: JointMesh) -> float:
    """Longest side of the box around a mesh [m]; collective."""
    points = mesh.domain.geometry.x
    ends = np.array([points.max(axis=0, initial=-np.inf), -points.min(axis=0, initial=np.inf)])
    of_all = np.empty_like(ends)
    mesh.domain.comm.Allreduce(ends, of_all, op=MPI.MAX)
    return float(of_all.sum(axis=0).max())


def build_mesh(source: Path, parameters: Mapping[str, object], comm: MPI.Comm) -> JointMesh:
    """Build or read a mesh, check it, and distribute it.

    Args:
        source: A builder (.py) or a gmsh mesh (.msh) with named physical groups.
        parameters: Keyword arguments of the builder; empty for a mesh file.
        comm: All its ranks must call; gmsh runs on rank 0.

    Returns:
        The mesh with its names.

    Raises:
        MeshError: On every rank: no such file; an unknown, missing or wrong parameter; a builder that fails; no named
            body; cells of more than one type, outside all bodies, in two bodies or inverted; a boundary off the bodies;
            a rank without cells.
    """
    source, failure, found = Path(source), None, None
    with ExitStack() as opened:
        if comm.rank == 0:
            try:
                opened.enter_context(_compat.gmsh_model(MODEL_NAME))
                _fill_model(source, parameters)
                found = _inspect_model(source)
            except MeshError as error:
                failure = error
            except (Exception, SystemExit) as error:  # a builder that ends this rank would leave the others waiting
                failure = MeshError(f"{source}: {type(error).__name__}: {error}")
                failure.__cause__ = error
        message, found = comm.bcast((str(failure) if failure else None, found))
        if message is not None:
            raise failure or MeshError(message)
        domain, cell_tags, facet_tags = _compat.distribute_gmsh_model(comm, found.dimension)
    cells = domain.topology.index_map(found.dimension)
    if comm.allreduce(cells.size_local, op=MPI.MIN) == 0:
        few = f"{cells.size_global} cells leave one of {comm.size} ranks with none"
        raise MeshError(f"{source}: {few}; take fewer ranks")
    return JointMesh(domain, cell_tags, facet_tags, found.bodies, found.boundaries, found.smallest_scaled_jacobian)


def _fill_model(source: Path, parameters: Mapping[str, object]) -> None:
    """Run the builder, or read the file, into the current gmsh model."""
    if source.suffix not in (".py", ".msh"):
        raise MeshError(f'{source}: geometry ends in "{source.suffix}"; expected a builder (.py) or a gmsh mesh (.msh)')
    if not source.is_file():
        raise MeshError(f"{source}: no such file")
    if source.suffix == ".msh":
        if parameters:
            raise MeshError(f"{source}: a mesh file takes no parameters, got {', '.join(parameters)}; remove them")
        gmsh.merge(str(source))
        return
    with load_builder(source) as module:
        build = getattr(module, "build", None)
        if not callable(build):
            raise MeshError(f"{source}: no function `build`; a geometry builder defines `def build(*, ...) -> None`")
        _check_parameters(source, build, parameters)
        usual = inspect.signature(build).parameters.get("mesh_size")
        size = parameters.get("mesh_size", usual.default if usual else None)
        try:
            with _refuse_endless_meshes(source, size):
                build(**parameters)
        except ValueError as error:
            usual = {name: known.default for name, known in inspect.signature(build).parameters.items()}
            raise MeshError(f"{source}: {error}{hint_at_lengths(parameters, usual)}") from error
    if not _compat.gmsh_is_running():
        raise MeshError(f"{source}: `build` ends gmsh, and its mesh is lost; leave gmsh.finalize() out")


@contextmanager
def _refuse_endless_meshes(source: Path, size: object) -> Iterator[None]:
    """Compares a builder's ``mesh_size`` with the extent of what it drew, before gmsh begins: nothing stops it then."""
    generate = gmsh.model.mesh.generate

    def check_and_generate(*given: object, **named: object) -> None:
        box = np.reshape(gmsh.model.getBoundingBox(-1, -1), (2, 3))
        sides = (box[1] - box[0])[: gmsh.model.getDimension()]
        if isinstance(size, (int, float)) and (cells := math.prod(sides / size)) > MOST_CELLS:
            raise MeshError(
                f"{source}: {' x '.join(f'{side:.4g} m' for side in sides)} with mesh_size = {size:g} m would be up to "
                f"{cells:.1g} cells, more than {MOST_CELLS:.1g}; lengths are in m: were mm meant? "
                "Else give a larger mesh_size"
            )
        generate(*given, **named)

    gmsh.model.mesh.generate = staticmethod(check_and_generate)
    try:
        yield
    finally:
        gmsh.model.mesh.generate = staticmethod(generate)


@contextmanager
def load_builder(source: Path) -> Iterator[ModuleType]:
    """A builder as a module: it may import files beside it, as a script may, and nothing of it stays loaded.

    No bytecode is written: the folder is the user's.

    Raises:
        Exception: What the file raises when it is run.
    """
    name = f"_geometry_{source.stem}"
    path, known, mute = list(sys.path), set(sys.modules), sys.dont_write_bytecode
    specification = importlib.util.spec_from_file_location(name, source)
    module = importlib.util.module_from_spec(specification)
    sys.path.insert(0, str(source.parent.resolve()))
    sys.dont_write_bytecode = True
    sys.modules[name] = module  # dataclasses look up the module that defines them
    importlib.invalidate_caches()
    try:
        specification.loader.exec_module(module)
        yield module
    finally:
        folders = [folder for folder in sys.path if folder not in path]
        for loaded in set(sys.modules) - known:
            found = importlib.machinery.PathFinder.find_spec(loaded.partition(".")[0], folders)
            if loaded == name or (found and found.has_location):
                del sys.modules[loaded]
        sys.path[:], sys.dont_write_bytecode = path, mute


def _check_parameters(source: Path, build: Callable, parameters: Mapping[str, object]) -> None:
    """Compare names and types with the builder's signature; signs and fit are the builder's own business."""
    known = inspect.signature(build).parameters
    open_ended = any(parameter.kind is parameter.VAR_KEYWORD for parameter in known.values())
    hints = typing.get_type_hints(build)
    for name, value in parameters.items():
        if name not in known and not open_ended:
            hint = nearest(name, known) or f"; known are {', '.join(known)}"
            raise MeshError(f'{source}: unknown parameter "{name}" = {value!r}{hint}')
        expected = hints.get(name)
        if expected is float:
            fits = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
        elif expected is int:
            fits = isinstance(value, int) and not isinstance(value, bool)
        else:
            fits = expected not in (bool, str) or isinstance(value, expected)
        if not fits:
            wanted = {float: "a finite number", int: "a whole number", bool: "true or false", str: "text"}[expected]
            raise MeshError(f"{source}: parameter {name} = {value!r}: expected {wanted}")
    missing = [
        name
        for name, parameter in known.items()
        if parameter.default is parameter.empty
        and parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
        and name not in parameters
    ]
    if missing:
        raise MeshError(f"{source}: parameter {missing[0]} has no default; give it a value")


def _inspect_model(source: Path) -> _Inspection:
    """Check the current gmsh model and number its nodes without gaps, as dolfinx needs them."""
    dimension = gmsh.model.getDimension()
    if dimension < 2 or not any(len(tags) for tags in gmsh.model.mesh.getElements(dimension)[1]):
        wanted = max(2, dimension)
        call = f"was it made by gmsh -{wanted}"
        if source.suffix == ".py":
            call = f"does the builder call gmsh.model.mesh.generate({wanted})"
        raise MeshError(f"{source}: the model has no mesh of {'volumes' if wanted == 3 else 'surfaces'}; {call}?")
    bodies, boundaries = _name_groups(source, dimension), _name_groups(source, dimension - 1)
    if not bodies:
        raise MeshError(f"{source}: no named body; give each body a physical group of dimension {dimension}")
    kind, order, corners = _check_cell_types(source, dimension, bodies)
    _check_facets(source, dimension, boundaries, kind)

    gmsh.model.mesh.renumberNodes()
    numbers, positions, _ = gmsh.model.mesh.getNodes()
    coordinates = np.empty((len(numbers), 3))
    coordinates[numbers.astype(np.int64) - 1] = positions.reshape(-1, 3)
    if dimension == 2 and np.ptp(coordinates[:, 2]) > 1e-9 * np.ptp(coordinates, axis=0).max():
        raise MeshError(
            f"{source}: z runs from {coordinates[:, 2].min()} to {coordinates[:, 2].max()}; "
            "a plane mesh lies in the x-y plane"
        )
    shape = _CELL_NAMES[dimension, corners]
    quality = math.inf
    for body, group in bodies.items():
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, group):
            nodes = gmsh.model.mesh.getElements(dimension, entity)[2][0].reshape(-1, order).astype(np.int64) - 1
            jacobians = evaluate_scaled_jacobian(coordinates[nodes[:, :corners], :dimension], shape)
            worst = int(np.argmin(jacobians))
            quality = min(quality, float(jacobians[worst]))
            if quality <= 0:
                middle = coordinates[nodes[worst, :corners]].mean(axis=0)[:dimension]
                place = ", ".join(f"{value:.6g}" for value in middle)
                raise MeshError(
                    f'{source}: body "{body}" has a {shape} with a scaled Jacobian of {quality:.3g} at '
                    f"({place}); expected more than 0: it is inverted, concave or flat"
                )
    return _Inspection(dimension, bodies, boundaries, quality)


def _name_groups(source: Path, dimension: int) -> dict[str, int]:
    """Name and number of every physical group of a dimension."""
    groups: dict[str, int] = {}
    for _, number in gmsh.model.getPhysicalGroups(dimension):
        name = gmsh.model.getPhysicalName(dimension, number)
        if not name:
            drawn = ("Point", "Curve", "Surface", "Volume")[dimension]
            raise MeshError(
                f"{source}: physical group {number} of dimension {dimension} has no name of its own; "
                f'give it one, with gmsh.model.setPhysicalName or, in a .geo file, Physical {drawn}("NAME") = ...'
            )
        if name in groups:
            raise MeshError(
                f'{source}: two physical groups of dimension {dimension} are called "{name}", '
                f"{groups[name]} and {number}; join them into one"
            )
        groups[name] = number
    return groups


def _find_owners(source: Path, dimension: int, groups: Mapping[str, int]) -> dict[int, str]:
    """The group of every grouped entity; an entity in two groups would have an ambiguous tag."""
    owner: dict[int, str] = {}
    for name, number in groups.items():
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, number):
            if entity in owner:
                raise MeshError(
                    f'{source}: entity {entity} of dimension {dimension} is in "{owner[entity]}" and in '
                    f'"{name}"; expected one name for each'
                )
            owner[int(entity)] = name
    return owner


def _check_cell_types(source: Path, dimension: int, bodies: Mapping[str, int]) -> tuple[int, int, int]:
    """One cell type in all bodies: its gmsh number, its number of nodes and of corners."""
    owner = _find_owners(source, dimension, bodies)
    types: dict[int, str] = {}
    for _, entity in gmsh.model.getEntities(dimension):
        kinds, cells, _ = gmsh.model.mesh.getElements(dimension, entity)
        if entity not in owner:
            if len(kinds):
                raise MeshError(
                    f"{source}: {sum(map(len, cells))} cells of entity {entity} belong to no body "
                    f"({', '.join(bodies)}); add the entity to a physical group"
                )
            continue
        if not len(kinds):
            raise MeshError(f'{source}: body "{owner[entity]}" has no cells in entity {entity}; mesh it or drop it')
        for kind in kinds:
            types.setdefault(int(kind), owner[entity])
    described = {kind: gmsh.model.mesh.getElementProperties(kind) for kind in types}
    if len(types) > 1:
        listing = ", ".join(f'{described[kind][0]} in "{body}"' for kind, body in types.items())
        raise MeshError(
            f"{source}: cells of {len(types)} types: {listing}; expected one type in all bodies "
            "(Mesh.RecombineAll with Mesh.RecombinationAlgorithm 3, or transfinite surfaces)"
        )
    kind, (label, _, _, nodes, _, corners) = next(iter(described.items()))
    if (dimension, corners) not in _CELL_NAMES:
        raise MeshError(f"{source}: cells are of type {label}; expected one of {', '.join(_CORNERS)}")
    if kind not in _COMPLETE:
        raise MeshError(
            f"{source}: cells are of type {label}; expected first order, or complete second order: "
            "Mesh.ElementOrder 1 or 2, Mesh.SecondOrderIncomplete 0"
        )
    return kind, nodes, corners


def _check_facets(source: Path, dimension: int, boundaries: Mapping[str, int], cell_kind: int) -> None:
    """Every named facet must be the facet of a cell: dolfinx drops the others, or crashes."""
    facets: dict[int, np.ndarray] = {}
    owner = _find_owners(source, dimension - 1, boundaries)
    for entity, name in owner.items():
        kinds, _, nodes = gmsh.model.mesh.getElements(dimension - 1, entity)
        if len(kinds) != 1:
            raise MeshError(
                f'{source}: boundary "{name}": entity {entity} holds {len(kinds)} types of mesh edges or '
                "faces; expected one. Is it the edge of a meshed body?"
            )
        _, _, _, size, _, corners = gmsh.model.mesh.getElementProperties(kinds[0])
        facets[entity] = np.sort(nodes[0].reshape(-1, size)[:, :corners], axis=1)
    if not facets:
        return
    named = np.concatenate(list(facets.values()))
    if dimension == 2:
        sides = gmsh.model.mesh.getElementEdgeNodes(cell_kind, primary=True)
    else:
        sides = gmsh.model.mesh.getElementFaceNodes(cell_kind, corners, primary=True)
    sides = np.asarray(sides).reshape(-1, corners)
    sides = np.sort(sides[np.isin(sides, named).all(axis=1)], axis=1)  # few: sorting whole rows is slow
    number = np.unique(np.concatenate([sides, named]), axis=0, return_inverse=True)[1].ravel()
    loose = ~np.isin(number[len(sides) :], number[: len(sides)])
    ends = np.cumsum([len(of_entity) for of_entity in facets.values()])
    for entity, mine in zip(facets, np.split(loose, ends[:-1]), strict=True):
        if mine.any():
            raise MeshError(
                f'{source}: boundary "{owner[entity]}": {np.count_nonzero(mine)} of {len(mine)} facets of entity '
                f"{entity} belong to no cell; is it the edge of a meshed body?"
            )


def evaluate_scaled_jacobian(corners: np.ndarray, shape: str) -> np.ndarray:
    """Smallest scaled Jacobian of each cell: the determinant of unit edges at a corner, relative to the ideal cell's.

    Args:
        corners: Corner coordinates in gmsh's order, ``(n_cells, n_corners, dimension)`` [m].
        shape: ``"triangle"``, ``"quadrilateral"``, ``"tetrahedron"`` or ``"hexahedron"``.

    Returns:
        ``(n_cells,)`` [-]: 1 for the ideal cell; zero or less where it is flat, concave or self-intersecting. A cell
        whose corners all turn the other way is a valid cell numbered backwards, and as good as its mirror image.

    Source: Stimpson et al., The Verdict Geometric Quality Library, SAND2007-1751 (2007).
    """
    neighbours, ideal = _CORNERS[shape]
    edges = corners[:, neighbours, :] - corners[:, :, None, :]
    lengths = np.linalg.norm(edges, axis=-1, keepdims=True)
    unit = np.divide(edges, lengths, out=np.zeros_like(edges), where=lengths > 0)
    determinants = np.linalg.det(unit) / ideal
    return np.maximum(determinants.min(axis=1), (-determinants).min(axis=1))
