"""A sector of a hub, the disk, on a ring, the blade: cut through their joint, which no sector may be."""

from __future__ import annotations

from math import cos, pi, sin

import gmsh


def build(*, sectors: int = 12, order: int = 1) -> None:
    """Adds both bodies, their mesh and the groups blade, disk, joint, low, high and clamp (the ring's bore)."""
    geo = gmsh.model.geo
    centre = geo.addPoint(0.0, 0.0, 0.0)
    low, high, bodies, joint, bore = [], [], [], [], 0
    for inner, outer in ((0.02, 0.03), (0.03, 0.05)):
        ends = [[geo.addPoint(r * cos(a), r * sin(a), 0.0) for a in (0.0, 2 * pi / sectors)] for r in (inner, outer)]
        arcs = [geo.addCircleArc(points[0], centre, points[1]) for points in ends]
        cuts = [geo.addLine(ends[0][k], ends[1][k]) for k in (0, 1)]
        for curve in (*arcs, *cuts):
            geo.mesh.setTransfiniteCurve(curve, 5)
        surface = geo.addPlaneSurface([geo.addCurveLoop([cuts[0], arcs[1], -cuts[1], -arcs[0]])])
        geo.mesh.setTransfiniteSurface(surface)
        geo.mesh.setRecombine(2, surface)
        bodies.append(surface)
        low.append(cuts[0])
        high.append(cuts[1])
        joint.append(arcs[0] if bore else arcs[1])
        bore = bore or arcs[0]
    geo.synchronize()
    gmsh.model.removeEntities([(0, centre)])
    groups = (("blade", 2, bodies[:1]), ("disk", 2, bodies[1:]), ("joint", 1, joint), ("low", 1, low))
    for name, dimension, members in (*groups, ("high", 1, high), ("clamp", 1, [bore])):
        gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, members), name)
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.setOrder(order)
