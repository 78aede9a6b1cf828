"""A block, the blade, in the inner corner of an L-shaped disk, and joints round bores of few edges."""

from __future__ import annotations

from math import cos, pi, sin

import gmsh


def build(*, around: int = 0, floor: float = 0.01, wall: float = 0.01, short: float = 0.0, flanks: int = 1) -> None:
    """Adds both bodies, their mesh and the groups blade, disk, tip and clamp, and the joint, to the current gmsh model.

    Args:
        around: Edges of a regular polygon, the blade, in a bore of that shape; 0: the block in its corner.
        floor: Width of the block [m].
        wall: Its height [m].
        short: How far from the corner the joint ends on either side [m].
        flanks: 1: "seat", round the corner; 2: "floor" and "wall".
    """
    geo = gmsh.model.geo

    def draw(corners: list[tuple[float, float]]) -> list[int]:
        points = [geo.addPoint(*corner, 0.0, 0.005) for corner in corners]
        return [geo.addLine(points[k], points[(k + 1) % len(points)]) for k in range(len(points))]

    if around:
        polygon = [(0.02 * cos(2 * pi * k / around), 0.02 * sin(2 * pi * k / around)) for k in range(around)]
        inner, bore = draw(polygon), draw(polygon)
        rim = draw([(-0.04, -0.04), (0.04, -0.04), (0.04, 0.04), (-0.04, 0.04)])
        blade, disk = [inner], [rim, bore]
        joint, clamp, tip = {"seat": inner + bore}, rim, []
        fixed = [(line, 1) for line in inner + bore]
    else:
        a, d = short, 0.01
        near = [(a, 0.0), (0.0, 0.0), (0.0, a)] if a else [(0.0, 0.0)]
        upper = draw([*near, (0.0, wall), (floor, wall), (floor, 0.0)])
        lower = draw([*near[::-1], (floor, 0.0), (floor, -d), (-d, -d), (-d, wall), (0.0, wall)])
        n = len(near)
        sides = {"wall": [upper[n - 1], lower[-1]], "floor": [upper[-1], lower[n - 1]]}
        joint = sides if flanks == 2 else {"seat": sides["wall"] + sides["floor"]}
        blade, disk, tip, clamp = [upper], [lower], [upper[n]], [lower[n + 1]]
        fixed = [(line, 4) for side in sides.values() for line in side]
    for line, edges in fixed:
        geo.mesh.setTransfiniteCurve(line, edges + 1)
    surfaces = [geo.addPlaneSurface([geo.addCurveLoop(loop) for loop in body]) for body in (blade, disk)]
    geo.synchronize()
    groups = {(2, "blade"): surfaces[:1], (2, "disk"): surfaces[1:], (1, "clamp"): clamp, (1, "tip"): tip}
    for (dimension, name), members in (groups | {(1, name): lines for name, lines in joint.items()}).items():
        if members:
            gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, members), name)
    gmsh.model.mesh.generate(2)
