"""Stacks of blocks side by side: a blade on a disk on a base, where base and disk are glued and the blade is not.

All blades are one body of separate pieces, and so are all disks.
"""

from __future__ import annotations

import gmsh

WIDTH = 0.02


def build(*, stacks: int = 1, base: str = "base", clamped: int = 1, loose: bool = False) -> None:
    """Adds the blocks, their mesh and the groups blade, disk, joint, clamp and tip to the current gmsh model.

    Args:
        stacks: How many.
        base: Name of the lowest blocks' body; "disk": the body on them goes down to the ground.
        clamped: How many of the stacks' bases are in the group "clamp".
        loose: Whether a block of the body "disk" lies beside the stacks, on the boundary "rest".
    """
    geo = gmsh.model.geo
    groups: dict[tuple[int, str], list[int]] = {}

    def block(body: str, corners: list[int], below: int | None = None) -> list[int]:
        lines = [geo.addLine(corners[k], corners[(k + 1) % 4]) for k in range(4) if k or below is None]
        lines = lines if below is None else [-below, *lines]
        surface = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        for line in lines:
            geo.mesh.setTransfiniteCurve(abs(line), 5)
        geo.mesh.setTransfiniteSurface(surface)
        geo.mesh.setRecombine(2, surface)
        groups.setdefault((2, body), []).append(surface)
        return lines

    def level(left: float, y: float) -> list[int]:
        return [geo.addPoint(left, y, 0.0), geo.addPoint(left + WIDTH, y, 0.0)]

    for k in range(stacks):
        left = 2 * WIDTH * k
        ground, glue, seat, root, top = (level(left, y) for y in (0.0, 0.01, 0.03, 0.03, 0.06))
        lowest = block(base, [*ground, *glue[::-1]])
        disk = block("disk", [*glue, *seat[::-1]], lowest[2])
        blade = block("blade", [*root, *top[::-1]])
        groups.setdefault((1, "joint"), []).extend([disk[2], blade[0]])
        groups.setdefault((1, "tip"), []).append(blade[2])
        if k < clamped:
            groups.setdefault((1, "clamp"), []).append(lowest[0])
    if loose:
        beside = block("disk", [*level(-2 * WIDTH, 0.0), *level(-2 * WIDTH, 0.02)[::-1]])
        groups[1, "rest"] = [beside[0]]
    geo.synchronize()
    for (dimension, name), members in groups.items():
        gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, members), name)
    gmsh.model.mesh.generate(2)
