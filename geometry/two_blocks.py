"""A block that stands on a wider one: the smallest joint with separation and friction.

            ____________
           |            |  upper     <- top
           |            |
      _____|____________|_____       <- seat, the flank
     |                        |
     |_________lower__________|      <- clamp

Physical groups: surfaces ``upper`` and ``lower``; curves ``seat`` (of both bodies), ``clamp`` (bottom of the lower
block) and ``top``. Coordinates in m; ``y = 0`` is the seat.
"""

from __future__ import annotations

from blocks import Body, check_pairs, check_positive, mesh_bodies
from outlines import count_cells


def build(
    *,
    width: float = 40.0e-3,
    height: float = 60.0e-3,
    lower_width: float = 80.0e-3,
    lower_height: float = 30.0e-3,
    pairs: int = 9,
    mesh_size: float = 5.0e-3,
) -> None:
    """Add both blocks to the current gmsh model, mesh them and name their groups.

    Args:
        width: Of the upper block [m].
        height: Of the upper block [m].
        lower_width: Of the lower block [m].
        lower_height: Of the lower block [m].
        pairs: Nodes on each side of the seat, ends included.
        mesh_size: Size of the cells away from the seat [m].

    Raises:
        ValueError: A parameter has the wrong sign, or the upper block is wider than the lower one; names the parameter.
    """
    check_positive(locals())
    if lower_width <= width:
        raise ValueError(f"lower_width = {lower_width}: expected more than width = {width}")
    check_pairs(pairs, "seat")
    half, wide = width / 2, lower_width / 2
    upper, lower = Body("upper"), Body("lower")
    on = upper.grid([-half, half], [0.0, height], [pairs - 1], [count_cells(height, mesh_size)])
    beside = count_cells(wide - half, mesh_size)
    under = lower.grid(
        [-wide, -half, half, wide],
        [-lower_height, 0.0],
        [beside, pairs - 1, beside],
        [count_cells(lower_height, mesh_size)],
    )
    mesh_bodies((upper, lower), {"seat": [*on.bottom, under.top[1]], "clamp": under.bottom, "top": on.top})
