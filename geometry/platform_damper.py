r"""Two blades side by side, and a wedge that the rotation presses against the undersides of their platforms.

            |  |          |  |
            |  |          |  |        airfoils
            |  |          |  |
         ___|  |___    ___|  |___
        |          |  |          |    platforms
        |         / __ \         |
        |  left  / /  \ \ right  |    <- the flanks, the wedge's sides, on which it slides
        |       / /____\ \       |
        |      |  damper  |      |
        |shank |          |shank |    (the wedge is drawn apart; in the mesh its sides lie on the platforms)
        |______|          |______|    y = 0

Physical groups: surfaces ``blades`` (both) and ``damper``; curves ``left`` and ``right`` (the flanks, of both bodies),
``clamp`` (the feet of the shanks), ``under`` (the wedge's lower side, on which a force stands for the rotation),
``tip_left`` and ``tip_right``. Coordinates in m; ``y`` points outwards, ``x = 0`` is halfway between the blades.
"""

from __future__ import annotations

from itertools import pairwise
from math import radians, tan

from blocks import Body, check_angle, check_pairs, check_positive, mesh_bodies
from outlines import count_cells


def build(
    *,
    flank_angle: float = 53.0,
    damper_width: float = 20.0e-3,
    damper_height: float = 8.0e-3,
    shank_height: float = 40.0e-3,
    shank_thickness: float = 14.0e-3,
    platform_thickness: float = 4.0e-3,
    airfoil_height: float = 80.0e-3,
    airfoil_thickness: float = 6.0e-3,
    pairs: int = 8,
    mesh_size: float = 3.0e-3,
) -> None:
    """Add both blades and the damper to the current gmsh model, mesh them and name their groups.

    Args:
        flank_angle: Angle of the flanks from the x direction [degrees].
        damper_width: Of the damper's lower side, which is the distance between the shanks [m].
        damper_height: Of the wedge [m].
        shank_height: From the foot to the damper's lower side [m].
        shank_thickness: Of each shank [m].
        platform_thickness: Of the platform above the wedge [m].
        airfoil_height: From the platform to the tip [m].
        airfoil_thickness: Of each airfoil, which stands in the middle of its shank [m].
        pairs: Nodes on each side of each flank, ends included.
        mesh_size: Size of the cells away from the flanks [m].

    Raises:
        ValueError: A parameter has the wrong sign, or the pieces do not fit together; names the parameter.
    """
    check_positive(locals())
    check_angle("flank_angle", flank_angle)
    check_pairs(pairs)
    if airfoil_thickness >= shank_thickness:
        raise ValueError(f"airfoil_thickness = {airfoil_thickness}: expected less than the shank's {shank_thickness}")
    wide = damper_width / 2
    narrow = wide - damper_height / tan(radians(flank_angle))
    if narrow <= 0:
        raise ValueError(
            f"damper_height = {damper_height}: expected less than {wide * tan(radians(flank_angle)):.5g}, where the "
            "flanks meet"
        )
    low, high = shank_height, shank_height + damper_height
    levels = [0.0, low, high, high + platform_thickness, high + platform_thickness + airfoil_height]
    rows = [count_cells(above - below, mesh_size) for below, above in pairwise(levels)]
    rows[1] = pairs - 1
    foot = wide + (shank_thickness - airfoil_thickness) / 2
    upright = [foot, foot + airfoil_thickness, wide + shank_thickness]
    lines = [[inner, *upright] for inner in (wide, wide, narrow, narrow)]  # from foot to platform; first the inner edge
    columns = [count_cells(right - left, mesh_size) for left, right in pairwise(lines[0])]

    blades, damper = Body("blades"), Body("damper")
    curves: dict[str, list[int]] = {"clamp": []}
    for side, hand in ((-1, "left"), (1, "right")):
        at = lambda x, level: (side * x, levels[level])  # noqa: B023, E731
        for row, (lower, upper) in enumerate(pairwise(lines)):
            for column, cells in enumerate(columns):
                corners = [at(upper[column], row + 1), at(lower[column], row)]
                corners += [at(lower[column + 1], row), at(upper[column + 1], row + 1)]
                inner, bottom, *_ = blades.patch(corners, (rows[row], cells))
                if row == 0:
                    curves["clamp"].append(bottom)
                if (row, column) == (1, 0):
                    curves[hand] = [inner]
        root, tip = len(levels) - 2, len(levels) - 1
        corners = [at(upright[0], tip), at(upright[0], root), at(upright[1], root), at(upright[1], tip)]
        *_, top = blades.patch(corners, (rows[-1], columns[1]))
        curves[f"tip_{hand}"] = [top]
    corners = [(-narrow, high), (-wide, low), (wide, low), (narrow, high)]
    left, under, right, _ = damper.patch(corners, (pairs - 1, count_cells(damper_width, mesh_size)))
    curves["left"].append(left)
    curves["right"].append(right)
    mesh_bodies((blades, damper), {**curves, "under": [under]})
