"""Two blades, clamped at their roots, whose shrouds meet at an inclined face: `right` and `left`."""

from __future__ import annotations

import math

import gmsh


def build(*, height: float = 0.12, width: float = 0.01, reach: float = 0.02, depth: float = 0.012, angle: float = 30.0):
    """Blades of a height and width, shrouds that reach to a face inclined by ``angle`` [deg] from the vertical."""
    lean = math.tan(math.radians(angle)) * depth / 2
    groups = {}
    for body, side in (("left", -1), ("right", 1)):
        inner, outer = side * reach, side * (reach + width)
        corners = [(outer, 0), (inner, 0), (inner, height), (outer, height)]
        corners += [(inner, height + depth), (outer, height + depth), (-lean, height), (lean, height + depth)]
        a, b, c, d, e, f, g, h = (gmsh.model.geo.addPoint(x, y, 0) for x, y in corners)
        ends = {"root": (a, b), "stem": (b, c), "neck": (c, d), "back": (d, a), "step": (c, e), "top": (e, f)}
        ends |= {"tip": (f, d), "under": (c, g), "face": (g, h), "over": (h, e)}
        cells = {"root": 2, "stem": 16, "neck": 2, "back": 16, "step": 6}
        cells |= {"top": 2, "tip": 6, "under": 4, "face": 6, "over": 4}
        line = {name: gmsh.model.geo.addLine(*pair) for name, pair in ends.items()}
        for name, count in cells.items():
            gmsh.model.geo.mesh.setTransfiniteCurve(line[name], count + 1)
        loops = [("root", "stem", "neck", "back"), ("step", "top", "tip", "-neck"), ("under", "face", "over", "-step")]
        blocks = []
        for loop in loops:
            curves = [-line[name[1:]] if name[0] == "-" else line[name] for name in loop]
            blocks.append(gmsh.model.geo.addPlaneSurface([gmsh.model.geo.addCurveLoop(curves)]))
            gmsh.model.geo.mesh.setTransfiniteSurface(blocks[-1])
            gmsh.model.geo.mesh.setRecombine(2, blocks[-1])
        groups[2, body] = blocks
        groups[1, f"root_{body}"], groups[1, f"top_{body}"] = [line["root"]], [line["top"]]
        groups.setdefault((1, "face"), []).append(line["face"])
    gmsh.model.geo.synchronize()
    for (dimension, name), members in groups.items():
        gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, members), name)
    gmsh.model.mesh.generate(2)
