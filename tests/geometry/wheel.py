"""A wheel of equal sectors, or one of them: in each a blade rests in a notch of the rim, on two flanks.

Blades may have shrouds at their tips, which reach to those of both neighbours. The bodies of a joint have two names:
that is why the half of a shroud towards the sector before belongs to the body ``disk``, though it grows on its blade.

Blades lean, so that the wheel has a sense. The first sector stands up along y; the next ones follow counter-clockwise
about the origin.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from math import cos, pi, sin
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "geometry"))

from blocks import Body, Point, mesh_bodies

HUB, RIM, NECK, TIP = 0.06, 0.08, 0.086, 0.11  # radii [m]: of the disk, of the blade above its legs
OUTER, INNER, DEPTH = 0.012, 0.003, 0.006  # where flanks begin and end from the middle, and how deep that is [m]
LEAN = 0.006  # of a tip, clockwise [m]
COLLAR, SLANT = 0.1, 0.03  # where shrouds begin [m], and by how much the ends of their faces are off the ray [rad]


def build(
    *,
    sectors: int = 5,
    whole: bool = False,
    whole_hub: bool = False,
    columns: int = 1,
    beside: int = 1,
    rows: int = 2,
    miss: float = 0.0,
    shrouds: bool = False,
) -> None:
    """Adds the sectors, their mesh and the groups blade, disk, hub, low, high, right_0, left_0, tip_0, floor_0 ...

    Shrouds meet on shroud_0 ...; those of the first sector alone end on ahead, towards the next one, and on behind.

    Args:
        sectors: How many make a wheel.
        whole: Whether all are there, without cuts, or the first one alone.
        whole_hub: Whether the disk is held all along its bore, up to the cuts, or below each notch alone.
        columns: Elements along a flank.
        beside: Elements between a notch and each cut, and over the height of the disk.
        rows: Elements over the height of a blade above its legs.
        miss: By how much a node of the high cut misses that of the next sector's low one [m].
        shrouds: Whether there are any.
    """
    blade, disk = Body("blade"), Body("disk")
    curves: dict[str, list[int]] = {"hub": [], "low": [], "high": []}
    for j in range(sectors if whole else 1):
        angle = 2 * pi * j / sectors

        def at(x: float, y: float, angle: float = angle) -> Point:
            return x * cos(angle) - y * sin(angle), x * sin(angle) + y * cos(angle)

        def on_cut(radius: float, side: int, at=at) -> Point:
            return at(-radius * sin(side * pi / sectors), radius * cos(pi / sectors))

        places = (OUTER, INNER, -INNER, -OUTER)  # from the low cut to the high one
        bore = [on_cut(HUB, -1), *(at(x, HUB) for x in places), on_cut(HUB + miss, 1)]
        notch = [at(x, RIM if abs(x) == OUTER else RIM - DEPTH) for x in places]
        rim = [on_cut(RIM, -1), *notch, on_cut(RIM, 1)]
        cells = (beside, columns, 2, columns, beside)
        sides = []
        for k, ((a, b), (c, d)) in enumerate(zip(pairwise(bore), pairwise(rim), strict=True)):
            sides.append(disk.patch([a, c, d, b], (beside, cells[k])))
            if whole_hub or k in (1, 2, 3):
                curves["hub"].append(sides[k][3])
        if not whole:
            curves |= {"low": [sides[0][0]], "high": [sides[4][2]]}
        heights = (NECK, COLLAR, TIP) if shrouds else (NECK, TIP)
        lines = [[at(x - LEAN * (y - NECK) / (TIP - NECK), y) for x in places] for y in heights]
        neck, own = lines[0], Body("blade")  # that shares no nodes with other blades where shrouds meet
        right, left = (own.patch([notch[k], neck[k], neck[k + 1], notch[k + 1]], (1, columns))[3] for k in (0, 2))
        for lower, upper in pairwise(lines):
            blocks = [[lower[k], upper[k], upper[k + 1], lower[k + 1]] for k in range(3)]
            tip = [own.patch(corners, (rows, cells[k + 1]))[1] for k, corners in enumerate(blocks)]
        curves |= {f"right_{j}": [right, sides[1][1]], f"left_{j}": [left, sides[3][1]]}
        for k, side in ((0, -1), (3, 1)) if shrouds else ():
            below, above = (
                at(-radius * sin(side * pi / sectors + askew), radius * cos(side * pi / sectors + askew))
                for radius, askew in ((0.9 * COLLAR, -SLANT), (0.9 * TIP, SLANT))
            )
            face = own.patch([lines[1][k], lines[2][k], above, below], (rows, 3))[2]
            if side == -1:
                disk.surfaces.append(own.surfaces.pop())
            alone = "ahead" if side == 1 else "behind"
            curves.setdefault(f"shroud_{(j + (side - 1) // 2) % sectors}" if whole else alone, []).append(face)
        blade.surfaces += own.surfaces
        curves |= {f"tip_{j}": tip, f"floor_{j}": [sides[2][1]]}  # the floor of the notch is the disk's
    mesh_bodies([blade, disk], {name: members for name, members in curves.items() if members})
