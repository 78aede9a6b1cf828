r"""Solids: the plane mesh of another builder drawn out along ``z``, into layers of hexahedra.

              ____________
             /           /|
            /___________/ |
       y   |           |  |
       |   |front_BODY |  |    <- of the curves of a boundary: faces, in as many strips as there are layers
       |   |           | /
       |   |___________|/         the front: z = depth; skew > 0 moves it to +x
       |________ x
      /
     z

The back, ``z = 0``, is the profile as its builder draws it; ``x``, ``y`` and the lengths [m] are that one's.

Physical groups: volumes with the names of the profile's bodies; surfaces with the names of its boundaries, and
``front_BODY`` and ``back_BODY``, the end faces of each body. The nodes of the two sides of a flank coincide but stay
distinct, as they do in the profile.
"""

from __future__ import annotations

import inspect
import runpy
import sys
import typing
from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from math import inf, isfinite, radians, tan
from pathlib import Path

import gmsh
import numpy as np

SOLIDS = ("extruded", "twisted_blade")  # builders beside this file that are of no profile
HERE = Path(__file__).resolve().parent
KINDS = {1: 1, 2: 3, 3: 5}  # dimension -> gmsh's number of the line, the quadrilateral and the hexahedron
TYPES = {float: "a finite number", int: "a whole number", bool: "true or false", str: "text"}


class Plane(typing.NamedTuple):
    """The mesh of a profile.

    Attributes:
        points: Positions of its nodes [m], ``(n, 3)``.
        edges: Nodes, counted from 0, of the edges on every curve of a boundary, ``(k, 2)``.
        cells: Nodes of the quadrilaterals on every surface, counter-clockwise, ``(k, 4)``.
        groups: Dimension, number, name, and tags of the curves or surfaces of every physical group.
    """

    points: np.ndarray
    edges: dict[int, np.ndarray]
    cells: dict[int, np.ndarray]
    groups: list[tuple[int, int, str, np.ndarray]]


def build(
    *, profile: str = "dovetail", depth: float = 12.0e-3, layers: int = 6, skew: float = 0.0, **of_profile: object
) -> None:
    """Make the current gmsh model, which is begun anew, that of the solids: their mesh and its named groups.

    Args:
        profile: Plane builder: the name of one beside this file, or the path of any, ``.py``, absolute or from here.
        depth: Length of the bodies along z [m].
        layers: Cells along z.
        skew: Broach angle, at which the bodies run off the z direction towards x [degrees].
        of_profile: Parameters of the profile.

    Raises:
        ValueError: A parameter or the profile's mesh does not fit; names the parameter.
    """
    if not 0 < depth < inf:
        raise ValueError(f"depth = {depth}: expected a positive number")
    if layers < 1:
        raise ValueError(f"layers = {layers}: expected at least 1")
    if not abs(skew) < 60.0:
        raise ValueError(f"skew = {skew}: expected degrees from the z direction, less than 60")
    draw = _load_profile(profile)
    _check_parameters(profile, draw, of_profile)
    draw(**of_profile)
    try:
        plane = _read_plane()
    except ValueError as error:
        raise ValueError(f'profile = "{profile}": {error}') from None
    model = gmsh.model.getCurrent()
    gmsh.model.remove()
    gmsh.model.add(model)
    _draw_out(plane, layers, depth * np.array([tan(radians(skew)), 0.0, 1.0]))


def _load_profile(profile: str) -> Callable:
    """The function ``build`` of a profile."""
    path = HERE / (profile if profile.endswith(".py") else f"{profile}.py")
    if not path.is_file():
        known = [file.stem for file in sorted(HERE.glob("*.py")) if "\ndef build(" in file.read_text(encoding="utf-8")]
        hint = _hint(profile, [name for name in known if name not in SOLIDS])
        raise ValueError(f'profile = "{profile}": no builder {path}{hint}, and others by their path, with .py')
    sys.path.insert(0, str(path.parent))  # it may import files beside it, now or as it draws
    draw = runpy.run_path(str(path)).get("build")
    if not callable(draw):
        raise ValueError(f'profile = "{profile}": no function `build` in {path}')
    return draw


def _check_parameters(profile: str, draw: Callable, given: Mapping[str, object]) -> None:
    """Compare names and types with the signature of the profile's ``build``."""
    known, types = inspect.signature(draw).parameters, typing.get_type_hints(draw)
    own = build.__kwdefaults__
    for name in sorted(set(known) & set(own)):
        raise ValueError(f'profile = "{profile}": it has a parameter {name}, a name that is taken here; rename it')
    open_ended = any(parameter.kind is parameter.VAR_KEYWORD for parameter in known.values())
    for name, value in given.items():
        if name not in known and not open_ended:
            hint = _hint(name, [*own, *known])
            raise ValueError(f'unknown parameter "{name}" = {value!r}, also of profile "{profile}"{hint}')
        expected = types.get(name)
        fits = expected not in TYPES or isinstance(value, int | float if expected is float else expected)
        if not fits or (expected in (float, int) and (isinstance(value, bool) or not isfinite(value))):
            raise ValueError(f'parameter {name} = {value!r} of profile "{profile}": expected {TYPES[expected]}')


def _hint(name: str, known: Iterable[str]) -> str:
    found = get_close_matches(name, known, n=1, cutoff=0.5)
    return f'; did you mean "{found[0]}"?' if found else f"; known are {', '.join(known)}"


def _read_plane() -> Plane:
    """The current gmsh model, which must have a mesh of quadrilaterals of first order."""
    if gmsh.model.getDimension() != 2:
        raise ValueError("expected a builder of a plane mesh")
    groups = [
        (d, number, gmsh.model.getPhysicalName(d, number), gmsh.model.getEntitiesForPhysicalGroup(d, number))
        for d, number in gmsh.model.getPhysicalGroups()
        if d in (1, 2)
    ]
    names = {name for _, _, name, _ in groups}
    for taken in sorted(names & {f"{end}_{body}" for d, _, body, _ in groups if d == 2 for end in ("front", "back")}):
        raise ValueError(f'its group "{taken}" has the name of an end face of the solid; rename it')
    curves = sorted({int(curve) for d, _, _, members in groups if d == 1 for curve in members})
    cells = {surface: _read_cells(2, surface) for _, surface in gmsh.model.getEntities(2)}
    edges = {curve: _read_cells(1, curve) for curve in curves}
    used = np.unique(np.concatenate([some.ravel() for some in (*cells.values(), *edges.values())]))
    tags, positions, _ = gmsh.model.mesh.getNodes()
    order = np.argsort(tags)
    points = positions.reshape(-1, 3)[order[np.searchsorted(tags, used, sorter=order)]]
    for found in (edges, cells):
        found.update({entity: np.searchsorted(used, nodes) for entity, nodes in found.items()})
    for surface, nodes in cells.items():
        along, across = points[nodes[:, 2]] - points[nodes[:, 0]], points[nodes[:, 3]] - points[nodes[:, 1]]
        clockwise = np.cross(along, across)[:, 2] < 0
        cells[surface] = np.where(clockwise[:, None], nodes[:, ::-1], nodes)
    return Plane(points, edges, cells, groups)


def _read_cells(dimension: int, entity: int) -> np.ndarray:
    """Tags of the nodes of the edges or cells of an entity, ``(k, 2)`` or ``(k, 4)``."""
    kinds, _, nodes = gmsh.model.mesh.getElements(dimension, entity)
    if any(kind != KINDS[dimension] for kind in kinds):
        label = gmsh.model.mesh.getElementProperties(max(kinds))[0]
        raise ValueError(
            f"its mesh has cells of type {label}; expected quadrilaterals of first order: "
            "gmsh.model.mesh.setRecombine for every surface, and no Mesh.ElementOrder above 1"
        )
    return np.concatenate([np.empty(0, dtype=np.uint64), *nodes]).astype(np.int64).reshape(-1, 2 * dimension)


def _draw_out(plane: Plane, layers: int, run: np.ndarray) -> None:
    """Fill the current gmsh model with the solid between the profile and its place after ``run`` [m].

    An entity of the profile becomes the one of the next dimension with its tag, a group the one with its number.
    """
    size = len(plane.points)  # node k of the plane is number 1 + k + size * layer of the solid
    start = size * np.arange(layers)[:, None, None] + 1
    for surface in plane.cells:
        gmsh.model.addDiscreteEntity(3, surface)
    points = plane.points + np.arange(layers + 1)[:, None, None] / layers * run
    gmsh.model.mesh.addNodes(3, min(plane.cells), np.arange(1, points.size // 3 + 1), points.ravel())
    for surface, cells in plane.cells.items():
        _add_cells(3, surface, np.concatenate([cells + start, cells + start + size], axis=2))
    for curve, edges in plane.edges.items():
        gmsh.model.addDiscreteEntity(2, curve)
        _add_cells(2, curve, np.concatenate([edges + start, edges[:, ::-1] + start + size], axis=2))
    for d, number, name, members in plane.groups:
        gmsh.model.setPhysicalName(d + 1, gmsh.model.addPhysicalGroup(d + 1, members, number), name)
    for body, members in [(name, members) for d, _, name, members in plane.groups if d == 2]:
        cells = np.concatenate([plane.cells[surface] for surface in members]) + 1
        for name, faces in ((f"front_{body}", cells + size * layers), (f"back_{body}", cells[:, ::-1])):
            surface = gmsh.model.addDiscreteEntity(2)
            _add_cells(2, surface, faces)
            gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, [surface]), name)
    gmsh.model.mesh.reclassifyNodes()


def _add_cells(dimension: int, entity: int, cells: np.ndarray) -> None:
    if cells.size:
        gmsh.model.mesh.addElementsByType(entity, KINDS[dimension], [], cells.ravel())
