"""From a geometry builder or a gmsh file to a distributed mesh whose bodies and boundaries carry their names.

A builder is a Python file with ``build(*, parameter: type = default, ...) -> None``: it adds geometry, mesh and
physical groups to the current gmsh model (``geometry/fir_tree.py`` is one), and may import files beside it. gmsh runs
on rank 0 alone, and ``gmsh_inspection.py`` checks the model before dolfinx sees it.
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
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType

import dolfinx
import gmsh
import numpy as np
from mpi4py import MPI

from ewr_fenicsx.errors import MeshError, nearest, tell_mistake
from ewr_fenicsx.scene.scene_sense import hint_at_lengths
from ewr_fenicsx.structure import _compat
from ewr_fenicsx.structure.gmsh_inspection import inspect_model

MODEL_NAME = "ewr_fenicsx"
MOST_CELLS = 1e6  # in the box around a geometry; more take long, and nobody means them


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

    @property
    def cells(self) -> int:
        """Number of cells on all ranks."""
        return self.domain.topology.index_map(self.dimension).size_global


@dataclass(frozen=True)
class Ring:
    """The ring that equal sectors form, and the wave of the load round it.

    Attributes:
        sectors: How many there are.
        engine_order: As in ``CyclicSymmetry``.
        low: Name of the boundary that the sector before has as its high one; None: only contact joins the sectors.
        high: Name of that which the next sector has as its low one: the low one, turned by ``2 pi / sectors``.
        flanks: Name -> the sector's boundary on which the next sector lies, and which of its boundaries that is.
        centre: Where the axis meets the plane, of solids any point of it, ``(d,)`` [m].
        axis: Its direction, about which sectors follow one another; of a plane only its last component counts.
    """

    sectors: int
    engine_order: int
    low: str | None
    high: str | None
    centre: tuple[float, ...]
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    flanks: Mapping[str, tuple[str, str]] = field(default_factory=dict)


def rotate_by_sector(ring: Ring, dimension: int) -> np.ndarray:
    """Rotation about the axis from a sector to the next one, ``(d, d)``, by Rodrigues' formula."""
    along = np.array(ring.axis) / np.linalg.norm(ring.axis)
    across = np.cross(np.eye(3), along)  # times a vector: the axis, cross that vector
    angle = 2 * np.pi / ring.sectors
    rotation = np.eye(3) + np.sin(angle) * across + (1 - np.cos(angle)) * across @ across
    return rotation[:dimension, :dimension]


def measure_extent(mesh: JointMesh) -> float:
    """Longest side of the box around a mesh [m]; collective."""
    points = mesh.domain.geometry.x
    ends = np.array([points.max(axis=0, initial=-np.inf), -points.min(axis=0, initial=np.inf)])
    of_all = np.empty_like(ends)
    mesh.domain.comm.Allreduce(ends, of_all, op=MPI.MAX)
    return float(of_all.sum(axis=0).max())


def find_body_of_cells(mesh: JointMesh) -> np.ndarray:
    """Tag of the body of every cell that this rank holds, ghosts included, ``(cells,)``."""
    cells = mesh.domain.topology.index_map(mesh.dimension)
    body = np.zeros(cells.size_local + cells.num_ghosts, dtype=np.int32)
    body[mesh.cell_tags.indices] = mesh.cell_tags.values
    return body


def number_faces(mesh: JointMesh, cells: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Which of its cell's own faces each facet is, of the cells beside them."""
    faces_of = mesh.domain.topology.connectivity(mesh.dimension, mesh.dimension - 1)
    found = [np.flatnonzero(faces_of.links(c) == f)[0] for c, f in zip(cells, facets, strict=True)]
    return np.array(found, dtype=np.int64)


def find_cells_beside(mesh: JointMesh, facets: np.ndarray) -> np.ndarray:
    """Local number of the cell beside each exterior facet."""
    cells_of = mesh.domain.topology.connectivity(mesh.dimension - 1, mesh.dimension)
    return np.array([cells_of.links(f)[0] for f in facets], dtype=np.int32)


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
            body; cells of more than one type, outside all bodies, in two bodies, there twice or inverted; a boundary
            off the bodies, or with facets of another one; a rank without cells, or ranks between which it parts.
    """
    source, failure, found = Path(source), None, None
    with ExitStack() as opened:
        if comm.rank == 0:
            try:
                opened.enter_context(_compat.gmsh_model(MODEL_NAME))
                _fill_model(source, parameters)
                found = inspect_model(source)
            except MeshError as error:
                failure = error
            except KeyboardInterrupt:
                raise
            except BaseException as error:  # a builder that ends this rank would leave the others waiting
                failure = MeshError(f"{source}: {tell_mistake(source, error)}")
                failure.__cause__ = error
        message, found = comm.bcast((str(failure) if failure else None, found))
        if message is not None:
            raise failure or MeshError(message)
        domain, cell_tags, facet_tags = _compat.distribute_gmsh_model(comm, found.dimension)
    cells = domain.topology.index_map(found.dimension)
    if comm.allreduce(cells.size_local, op=MPI.MIN) == 0:
        few = f"{cells.size_global} cells leave one of {comm.size} ranks with none"
        raise MeshError(f"{source}: {few}; take fewer ranks")
    if (doubled := domain.geometry.index_map().size_global - found.nodes) > 0:
        raise MeshError(
            f"{source}: on {comm.size} ranks the mesh comes apart, with more nodes than it has, by {doubled}: where "
            "pieces share an edge or a corner and no facet, each rank has its own; let them share facets or nothing, "
            "or take one rank"
        )
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

    Modules of their names that the program has from elsewhere are put aside meanwhile. No bytecode is written: the
    folder is the user's.

    Raises:
        Exception: What the file raises when it is run.
    """
    name = f"_geometry_{source.stem}"
    path, known, mute = list(sys.path), set(sys.modules), sys.dont_write_bytecode
    specification = importlib.util.spec_from_file_location(name, source)
    module = importlib.util.module_from_spec(specification)
    sys.path.insert(0, str(source.parent.resolve()))
    sys.dont_write_bytecode = True
    namesakes = _find_namesakes(source.parent.resolve())
    aside = {loaded: sys.modules.pop(loaded) for loaded in known if loaded.partition(".")[0] in namesakes}
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
        sys.modules.update(aside)
        sys.path[:], sys.dont_write_bytecode = path, mute


def _find_namesakes(folder: Path) -> set[str]:
    """Names of loaded modules that a folder has others of; not Python's own, nor installed ones, nor this package."""
    names = {path.stem for path in folder.glob("*.py")} | {path.parent.name for path in folder.glob("*/__init__.py")}
    loaded = names.intersection(sys.modules) - sys.stdlib_module_names - {"__main__", __name__.partition(".")[0]}
    homes = {name: Path(getattr(sys.modules[name], "__file__", None) or "/").resolve() for name in loaded}
    installed = {name for name, at in homes.items() if {"site-packages", "dist-packages"}.intersection(at.parts)}
    own = {name for name, at in homes.items() if at in (folder / f"{name}.py", folder / name / "__init__.py")}
    return loaded - installed - own


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
