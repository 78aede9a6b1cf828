"""What must hold of a gmsh model before dolfinx sees it: cells of one type, none inverted, in named bodies.

dolfinx 0.5 ends with a segmentation fault on a mesh of triangles and quadrilaterals, on one in which nodes of no cell
have lower numbers than others, and on cells that are there twice; it drops facets of no cell, and all but one name of a
facet.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import gmsh
import numpy as np

from ewr_fenicsx.errors import MeshError

# The corners next to each corner, turned so that an uninverted cell gives positive determinants, and the determinant
# of unit edges in the ideal cell.
_CORNERS = {
    "triangle": ([(1, 2), (2, 0), (0, 1)], math.sqrt(3) / 2),
    "quadrilateral": ([(1, 3), (2, 0), (3, 1), (0, 2)], 1.0),
    "tetrahedron": ([(1, 2, 3), (2, 0, 3), (0, 1, 3), (0, 2, 1)], math.sqrt(2) / 2),
    "hexahedron": ([(1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7), (7, 5, 0), (4, 6, 1), (5, 7, 2), (6, 4, 3)], 1.0),
}
_FOLDED = 1e-6  # of the largest Jacobian of a cell, below which a negative one is rounding
_COMPLETE = (2, 3, 4, 5, 9, 10, 11, 12)  # numbers of these in gmsh, of first order and with all nodes of second order
_CELL_NAMES = {(2, 3): "triangle", (2, 4): "quadrilateral", (3, 4): "tetrahedron", (3, 8): "hexahedron"}


@dataclass(frozen=True)
class Inspection:
    """What rank 0 tells the others about the checked gmsh model; attributes as in ``mesh.JointMesh``, and its nodes."""

    dimension: int
    nodes: int
    bodies: dict[str, int]
    boundaries: dict[str, int]
    smallest_scaled_jacobian: float


def inspect_model(source: Path) -> Inspection:
    """Checks the current gmsh model, drops what is on no body and numbers nodes without gaps, as dolfinx needs them.

    Args:
        source: Where it came from, for messages.

    Raises:
        MeshError: No mesh, no named body, a boundary off the bodies or with facets of another one; cells of more than
            one type, outside all bodies, in two bodies, there twice or inverted, also by curved sides alone.
    """
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
    _check_cells_differ(source, kind, order, corners)
    _check_facets(source, dimension, boundaries, kind)

    _drop_what_is_on_no_body(dimension)
    gmsh.model.mesh.renumberNodes()
    numbers, positions, _ = gmsh.model.mesh.getNodes()
    coordinates = np.empty((len(numbers), 3))
    coordinates[numbers.astype(np.int64) - 1] = positions.reshape(-1, 3)
    of_cells = coordinates[np.unique(gmsh.model.mesh.getElementsByType(kind)[1]).astype(np.int64) - 1]
    if dimension == 2 and np.ptp(of_cells[:, 2]) > 1e-9 * np.ptp(of_cells, axis=0).max():
        raise MeshError(
            f"{source}: z runs from {of_cells[:, 2].min()} to {of_cells[:, 2].max()}; "
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
                place = _name_middle(coordinates[nodes[worst, :corners], :dimension])
                raise MeshError(
                    f'{source}: body "{body}" has a {shape} with a scaled Jacobian of {quality:.3g} at '
                    f"({place}); expected more than 0: it is inverted, concave or flat"
                )
            if order > corners and (folded := find_folded(kind, coordinates[nodes, :dimension])).any():
                place = _name_middle(coordinates[nodes[np.argmax(folded), :corners], :dimension])
                raise MeshError(
                    f'{source}: body "{body}" has a {shape} that its curved sides turn inside out, at ({place}); take '
                    "more cells along the curve there, or thicker ones beside it"
                )
    return Inspection(dimension, len(of_cells), bodies, boundaries, quality)


def _drop_what_is_on_no_body(dimension: int) -> None:
    """Points, curves and faces none of whose nodes a cell has, such as centres of arcs and drawn axes."""
    of_cells = np.concatenate(gmsh.model.mesh.getElements(dimension)[2])
    of_none = np.setdiff1d(gmsh.model.mesh.getNodes()[0], of_cells)
    for lower in reversed(range(dimension)) if len(of_none) else ():  # ends of curves go after them
        for entity in gmsh.model.getEntities(lower):
            own = gmsh.model.mesh.getNodes(*entity, includeBoundary=True)[0]
            if len(own) and np.isin(own, of_none).all():
                gmsh.model.removeEntities([entity])


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
            if owner.get(entity) == name:
                raise MeshError(
                    f'{source}: "{name}" holds entity {entity} of dimension {dimension} twice; list it once, or, where '
                    "gmsh made one of what two bodies have at the same place, which glues them, keep two"
                )
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


def _check_cells_differ(source: Path, kind: int, order: int, corners: int) -> None:
    """No cell may be there twice, as of a body drawn twice whose nodes were merged: dolfinx crashes."""
    nodes = gmsh.model.mesh.getElementsByType(kind)[1].reshape(-1, order)[:, :corners]
    cells, count = np.unique(np.sort(nodes, axis=1), axis=0, return_counts=True)
    if len(cells) < len(nodes):
        place = _name_middle([gmsh.model.mesh.getNode(int(node))[0] for node in cells[np.argmax(count > 1)]])
        raise MeshError(
            f"{source}: {len(nodes) - len(cells)} of {len(nodes)} cells have the corners of others, as at ({place}); "
            "is a body drawn twice, or in two groups?"
        )


def _name_middle(corners: Sequence[np.ndarray]) -> str:
    """The middle of a cell's corners, for people."""
    return ", ".join(f"{value:.6g}" for value in np.mean(corners, axis=0))


def _check_facets(source: Path, dimension: int, boundaries: Mapping[str, int], cell_kind: int) -> None:
    """Every named facet must be the facet of a cell, and has one name: dolfinx drops others, or crashes."""
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
    of_sides, of_named = np.split(number, [len(sides)])
    of_entity = np.split(of_named, np.cumsum([len(rows) for rows in facets.values()])[:-1])
    for (entity, name), mine in zip(owner.items(), of_entity, strict=True):
        if loose := np.count_nonzero(~np.isin(mine, of_sides)):
            raise MeshError(
                f'{source}: boundary "{name}": {loose} of {len(mine)} facets of entity '
                f"{entity} belong to no cell; is it the edge of a meshed body?"
            )
    names = list(dict.fromkeys(owner.values()))
    of_name = np.repeat([names.index(name) for name in owner.values()], [len(rows) for rows in facets.values()])
    facet, name = np.divmod(np.unique(of_named * len(names) + of_name), len(names))
    shared = np.flatnonzero(facet[1:] == facet[:-1])
    if shared.size:
        one, other = name[shared[0]], name[shared[0] + 1]
        both = np.count_nonzero((name[shared] == one) & (name[shared + 1] == other))
        raise MeshError(
            f'{source}: {both} facets are in "{names[one]}" and in "{names[other]}"; expected one name for each'
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


def find_folded(kind: int, nodes: np.ndarray) -> np.ndarray:
    """Which cells turn inside out somewhere, though their corners may not: by the Jacobian at each of their nodes.

    Args:
        kind: gmsh's number of their type.
        nodes: Their coordinates in gmsh's order, ``(n_cells, n_nodes, dimension)`` [m].

    Returns:
        ``(n_cells,)``. A Jacobian of zero is none, as at the tip of a crack whose cells have their nodes at a quarter.
    """
    _, dimension, _, count, local, _ = gmsh.model.mesh.getElementProperties(kind)
    places = np.zeros((count, 3))
    places[:, :dimension] = np.reshape(local, (count, dimension))
    slopes = gmsh.model.mesh.getBasisFunctions(kind, places.ravel(), "GradLagrange")[1].reshape(count, count, 3)
    sizes = np.array([np.linalg.det(np.swapaxes(nodes, 1, 2) @ slope[:, :dimension]) for slope in slopes])
    sizes *= np.sign(sizes.sum(axis=0))
    return sizes.min(axis=0) < -_FOLDED * sizes.max(axis=0)
