"""A bar, held at one end, whose other end meets a block: it rubs there when it bends and taps there when it stretches.

     root                                tip      face
      ||___________________________________________|____
      ||                   bar             |       |    |
      ||___________________________________|_______|stop|  <- ground, the stop's far side
                                                   |____|

Physical groups: surfaces ``bar`` and ``stop``; curves ``face`` (of both bodies), ``root``, ``ground`` and ``tip``
(upper and lower edge of the bar's last part). Coordinates in m; the bar's axis is ``y = 0``, its root ``x = 0``.
"""

from __future__ import annotations

from blocks import Body, check_pairs, check_positive, mesh_bodies
from outlines import count_cells


def build(
    *,
    length: float = 200.0e-3,
    height: float = 10.0e-3,
    tip_length: float = 20.0e-3,
    stop_length: float = 20.0e-3,
    pairs: int = 5,
    mesh_size: float = 5.0e-3,
) -> None:
    """Add bar and stop to the current gmsh model, mesh them and name their groups.

    Args:
        length: Of the bar [m].
        height: Of the bar and the stop [m].
        tip_length: Of the part of the bar that is its tip [m].
        stop_length: Of the stop [m].
        pairs: Nodes on each side of the face, ends included.
        mesh_size: Length of the cells along the bar [m].

    Raises:
        ValueError: A parameter has the wrong sign, or the tip is longer than the bar; names the parameter.
    """
    check_positive(locals())
    if tip_length >= length:
        raise ValueError(f"tip_length = {tip_length}: expected less than length = {length}")
    check_pairs(pairs, "face")
    bar, stop = Body("bar"), Body("stop")
    ys, rows = [-height / 2, height / 2], [pairs - 1]
    cells = [count_cells(length - tip_length, mesh_size), count_cells(tip_length, mesh_size)]
    left = bar.grid([0.0, length - tip_length, length], ys, cells, rows)
    right = stop.grid([length, length + stop_length], ys, [count_cells(stop_length, mesh_size)], rows)
    mesh_bodies(
        (bar, stop),
        {
            "face": [*left.right, *right.left],
            "root": left.left,
            "ground": right.right,
            "tip": [left.bottom[1], left.top[1]],
        },
    )
