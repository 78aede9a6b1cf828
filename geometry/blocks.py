"""Bodies drawn as four-sided blocks with transfinite quadrilateral meshes: what the builders beside this file use.

Nothing is left to gmsh's mesh generators: the same parameters give the same mesh on every version of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import gmsh

Point = tuple[float, float]


@dataclass
class Body:
    """One body; neighbouring blocks share points and curves, bodies share none.

    Attributes:
        name: Of the physical group.
        surfaces: Tags of the blocks drawn so far.
    """

    name: str
    surfaces: list[int] = field(default_factory=list)
    _points: dict[Point, int] = field(default_factory=dict)
    _curves: dict[frozenset[int], tuple[int, int]] = field(default_factory=dict)

    def point(self, position: Point) -> int:
        """Tag of the point at a position [m], drawn when first asked for."""
        key = (round(position[0], 12) + 0.0, round(position[1], 12) + 0.0)  # no negative zero
        if key not in self._points:
            self._points[key] = gmsh.model.geo.addPoint(*key, 0.0)
        return self._points[key]

    def curve(self, start: Point, end: Point, cells: int, centre: Point | None = None, growth: float = 1.0) -> int:
        """Tag of the curve from start to end, negative where it was drawn the other way round.

        Args:
            start: Where it begins [m].
            end: Where it ends [m].
            cells: Cell edges along it.
            centre: Of the arc [m]; None: a straight line.
            growth: Ratio of neighbouring cell edges.
        """
        first, last = self.point(start), self.point(end)
        key = frozenset((first, last))
        if key not in self._curves:
            geo = gmsh.model.geo
            tag = geo.addLine(first, last) if centre is None else geo.addCircleArc(first, self.point(centre), last)
            geo.mesh.setTransfiniteCurve(tag, cells + 1, "Progression", growth)
            self._curves[key] = (tag, first)
        tag, drawn_from = self._curves[key]
        return tag if drawn_from == first else -tag

    def block(self, corners: Sequence[Point], sides: Sequence[int]) -> None:
        """Fill four sides, each from one corner to the next, with quadrilaterals, counter-clockwise."""
        if sum(a[0] * b[1] - b[0] * a[1] for a, b in pairwise([*corners, corners[0]])) < 0:
            # a mirrored half: turn the loop so that every cell has a positive Jacobian
            corners, sides = corners[::-1], [-side for side in sides[::-1]]
        surface = gmsh.model.geo.addPlaneSurface([gmsh.model.geo.addCurveLoop(list(sides))])
        gmsh.model.geo.mesh.setTransfiniteSurface(surface, cornerTags=[self.point(corner) for corner in corners])
        gmsh.model.geo.mesh.setRecombine(2, surface)
        self.surfaces.append(surface)

    def patch(self, corners: Sequence[Point], cells: tuple[int, int]) -> list[int]:
        """Fill a straight-sided block; tags of its four curves, the first from corner 0 to corner 1.

        Args:
            corners: Four, in turn [m].
            cells: Along the first and third side, and along the other two.
        """
        edges = pairwise([*corners, corners[0]])
        sides = [self.curve(start, end, cells[k % 2]) for k, (start, end) in enumerate(edges)]
        self.block(corners, sides)
        return sides

    def grid(self, xs: Sequence[float], ys: Sequence[float], across: Sequence[int], along: Sequence[int]) -> Edges:
        """Fill a rectangle with a grid of rectangular blocks.

        Args:
            xs: Rising positions of the vertical lines [m].
            ys: Rising positions of the horizontal lines [m].
            across: Cells in x between each two of ``xs``.
            along: Cells in y between each two of ``ys``.

        Returns:
            Tags of the curves on the rectangle's four edges.
        """
        level = lambda j: [self.curve((xs[i], ys[j]), (xs[i + 1], ys[j]), n) for i, n in enumerate(across)]  # noqa: E731
        upright = lambda i: [self.curve((xs[i], ys[j]), (xs[i], ys[j + 1]), n) for j, n in enumerate(along)]  # noqa: E731
        for i in range(len(across)):
            for j in range(len(along)):
                corners = [(xs[i], ys[j]), (xs[i + 1], ys[j]), (xs[i + 1], ys[j + 1]), (xs[i], ys[j + 1])]
                self.block(corners, [level(j)[i], upright(i + 1)[j], -level(j + 1)[i], -upright(i)[j]])
        return Edges(level(0), level(len(along)), upright(0), upright(len(across)))


class Edges(NamedTuple):
    """Curves on the edges of a rectangle, each from left to right or from bottom to top."""

    bottom: list[int]
    top: list[int]
    left: list[int]
    right: list[int]


def check_positive(parameters: Mapping[str, float]) -> None:
    """Refuse the parameters of a builder, its ``locals()`` as it begins, where one is not positive.

    Raises:
        ValueError: Names the parameter.
    """
    for name, value in parameters.items():
        if not value > 0:
            raise ValueError(f"{name} = {value}: expected a positive number")


def check_angle(name: str, value: float) -> None:
    """Refuse the angle of a flank of a builder [degrees] that is far from usual.

    Raises:
        ValueError: Names the parameter.
    """
    if not 15.0 <= value <= 75.0:
        raise ValueError(f"{name} = {value}: expected degrees from the x direction, 15 to 75")


def check_sectors(sectors: int) -> None:
    """Refuse fewer sectors than a ring of a builder is drawn with.

    Raises:
        ValueError: Names the parameter.
    """
    if sectors < 3:
        raise ValueError(f"sectors = {sectors}: expected 3 or more")


def check_pairs(pairs: int, flank: str = "flank") -> None:
    """Refuse fewer than two pairs on a flank of a builder, or on what it calls otherwise.

    Raises:
        ValueError: Names the parameter.
    """
    if pairs < 2:
        raise ValueError(f"pairs = {pairs}: expected at least 2, the ends of the {flank}")


def mirror(points: Sequence[Point], side: int) -> list[Point]:
    """Points of the right side, on the left (-1) or right (1) one."""
    return [(side * x, y) for x, y in points]


def mesh_bodies(bodies: Sequence[Body], boundaries: Mapping[str, Sequence[int]]) -> None:
    """Name the bodies and boundaries as physical groups, and mesh them.

    Args:
        bodies: All that was drawn.
        boundaries: Name -> tags of its curves, of either sign.
    """
    gmsh.model.geo.synchronize()
    _drop_arc_centres()
    for body in bodies:
        gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, body.surfaces), body.name)
    for name, curves in boundaries.items():
        gmsh.model.setPhysicalName(1, gmsh.model.addPhysicalGroup(1, [abs(curve) for curve in curves]), name)
    gmsh.model.mesh.generate(2)


def _drop_arc_centres() -> None:
    """Points that no curve ends in would become nodes without a cell."""
    ends = set(gmsh.model.getBoundary(gmsh.model.getEntities(1), combined=False, oriented=False))
    gmsh.model.removeEntities([point for point in gmsh.model.getEntities(0) if point not in ends])
