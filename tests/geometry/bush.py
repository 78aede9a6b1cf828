"""A ring, the blade, in the bore of a hub, the disk: a joint that closes on itself."""

from __future__ import annotations

from math import cos, pi, sin

import gmsh

BORE, FIT, RIM = 0.02, 0.03, 0.05


def build(*, around: int = 16, across: int = 2, order: int = 1, quarters: int = 4, grading: float = 1.0) -> None:
    """Adds both bodies, their mesh and the groups blade, disk, joint, tip (the ring's bore) and clamp (the hub's rim).

    Args:
        around: Elements round the joint, a multiple of four.
        across: Elements over the thickness of each body.
        order: Of the cells; of second order only the sides on the boundaries are curved.
        quarters: How many of the four of the bore are the joint; the first begins on the x axis.
        grading: Length of an element round the joint over that of the one before, quarter by quarter.
    """
    geo = gmsh.model.geo
    centre = geo.addPoint(0.0, 0.0, 0.0)

    def circle(radius: float) -> tuple[list[int], list[int]]:
        points = [geo.addPoint(radius * cos(k * pi / 2), radius * sin(k * pi / 2), 0.0) for k in range(4)]
        arcs = [geo.addCircleArc(points[k], centre, points[(k + 1) % 4]) for k in range(4)]
        for arc in arcs:
            geo.mesh.setTransfiniteCurve(arc, around // 4 + 1, "Progression", grading)
        return points, arcs

    def fill(inner: tuple[list[int], list[int]], outer: tuple[list[int], list[int]]) -> list[int]:
        spokes = [geo.addLine(*ends) for ends in zip(inner[0], outer[0], strict=True)]
        surfaces = []
        for spoke in spokes:
            geo.mesh.setTransfiniteCurve(spoke, across + 1)
        for k in range(4):
            loop = geo.addCurveLoop([spokes[k], outer[1][k], -spokes[(k + 1) % 4], -inner[1][k]])
            surfaces.append(geo.addPlaneSurface([loop]))
            geo.mesh.setTransfiniteSurface(surfaces[-1])
            geo.mesh.setRecombine(2, surfaces[-1])
        return surfaces

    bore, outside, inside, rim = (circle(radius) for radius in (BORE, FIT, FIT, RIM))
    ring, hub = fill(bore, outside), fill(inside, rim)
    geo.synchronize()
    gmsh.model.removeEntities([(0, centre)])
    for name, dimension, members in (
        ("blade", 2, ring),
        ("disk", 2, hub),
        ("joint", 1, outside[1][:quarters] + inside[1][:quarters]),
        ("tip", 1, bore[1]),
        ("clamp", 1, rim[1]),
    ):
        gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, members), name)
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.setOrder(order)
