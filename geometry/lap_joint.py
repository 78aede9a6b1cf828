"""Two beams, held at their far ends, that overlap and are bolted together: a single lap joint.

                              bolt_top
      ||_________________________##______
      ||          upper                  |          end
      ||_________________________________|_______________||
                          |           lower              ||
                          |______________________________||
                                 ##
                             bolt_bottom

Physical groups: surfaces ``upper`` and ``lower``; curves ``lap`` (the flank, of both bodies), ``bolt_top`` and
``bolt_bottom`` (where the washers press), ``end`` (the free end of the upper beam), ``left`` and ``right`` (the far
ends).
Coordinates in m; ``y = 0`` is the lap, ``x = 0`` its middle.
"""

from __future__ import annotations

from blocks import Body, check_positive, mesh_bodies
from outlines import count_cells


def build(
    *,
    length: float = 150.0e-3,
    height: float = 6.0e-3,
    overlap: float = 50.0e-3,
    washer: float = 14.0e-3,
    pairs: int = 26,
    rows: int = 4,
    mesh_size: float = 4.0e-3,
) -> None:
    """Add both beams to the current gmsh model, mesh them and name their groups.

    Args:
        length: Of each beam [m].
        height: Of each beam [m].
        overlap: Length of the lap [m].
        washer: Width on which the bolt presses [m].
        pairs: Nodes on each side of the lap, ends included.
        rows: Cells over the height of each beam.
        mesh_size: Length of the cells away from the lap [m].

    Raises:
        ValueError: A parameter has the wrong sign, or the washer or the overlap is too long; names the parameter.
    """
    check_positive(locals())
    if not washer < overlap < length:
        raise ValueError(f"overlap = {overlap}: expected between washer = {washer} and length = {length}")
    if pairs < 4:
        raise ValueError(f"pairs = {pairs}: expected at least 4, the ends of the lap and of the washer")
    half, under, far = overlap / 2, washer / 2, length - overlap / 2
    pressed = min(pairs - 3, max(1, round((pairs - 1) * washer / overlap)))
    left = (pairs - 1 - pressed) // 2
    lap = [left, pressed, pairs - 1 - pressed - left]
    free = count_cells(length - overlap, mesh_size)
    upper, lower = Body("upper"), Body("lower")
    above = upper.grid([-far, -half, -under, under, half], [0.0, height], [free, *lap], [rows])
    below = lower.grid([-half, -under, under, half, far], [-height, 0.0], [*lap, free], [rows])
    mesh_bodies(
        (upper, lower),
        {
            "lap": [*above.bottom[1:], *below.top[:3]],
            "bolt_top": [above.top[2]],
            "bolt_bottom": [below.bottom[1]],
            "end": above.right,
            "left": above.left,
            "right": below.right,
        },
    )
