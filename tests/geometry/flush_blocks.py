"""Two blocks, one on the other, with boundaries that hold curves of both and are no flanks: "sides" and "ends"."""

from __future__ import annotations

import gmsh


def build(*, width: float = 0.04, height: float = 0.02, rows: int = 5) -> None:
    """Adds blocks of a width and height [m] to the current gmsh model, and the groups blade, disk, joint, sides, ends.

    Of elements there are 5 along each side, but ``rows`` over the height of the blade.

    The sides are flush, so that the curves of "sides" go on across the joint; "ends" are its top and bottom. There is a
    group "clamp" on the other side of the disk.
    """
    geo, lines, surfaces = gmsh.model.geo, [], []
    for k in range(2):
        corners = [(0.0, k * height), (width, k * height), (width, (k + 1) * height), (0.0, (k + 1) * height)]
        points = [geo.addPoint(x, y, 0.0) for x, y in corners]
        lines.append([geo.addLine(points[i], points[(i + 1) % 4]) for i in range(4)])
        surfaces.append(geo.addPlaneSurface([geo.addCurveLoop(lines[k])]))
        for i, line in enumerate(lines[k]):
            geo.mesh.setTransfiniteCurve(line, 1 + (rows if (k, i % 2) == (1, 1) else 5))
        geo.mesh.setTransfiniteSurface(surfaces[k])
        geo.mesh.setRecombine(2, surfaces[k])
    geo.synchronize()
    (bottom, _, seat, left), (root, _, top, upper_left) = lines
    groups = {"joint": [seat, root], "sides": [left, upper_left], "ends": [bottom, top], "clamp": [lines[0][1]]}
    for dimension, members in ((2, {"disk": surfaces[:1], "blade": surfaces[1:]}), (1, groups)):
        for name, entities in members.items():
            gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, entities), name)
    gmsh.model.mesh.generate(2)
