"""A block on another one, of hexahedra, or of tetrahedra, six in place of each of these."""

from __future__ import annotations

from itertools import permutations

import gmsh
import numpy as np

CELLS = {"tetrahedra": 4, "hexahedra": 5}  # gmsh's numbers
FACES = {"tetrahedra": 2, "hexahedra": 3}


def build(
    *,
    kind: str = "tetrahedra",
    width: float = 0.02,
    height: float = 0.03,
    across: int = 3,
    up: int = 4,
    beside: int = 1,
    order: int = 1,
) -> None:
    """Adds the blocks and the groups blade, disk, joint, clamp and tip to the current gmsh model.

    Args:
        kind: Of the cells, "tetrahedra" or "hexahedra".
        width: Of the upper block [m].
        height: Of the upper block [m]; the lower one is half as high.
        across: Cells across the joint, either way.
        up: Cells over the height of the upper block.
        beside: Cells by which the lower block is wider, on every side.
        order: Of the mesh.
    """
    size = width / across
    blade = _Block(kind, [np.arange(across + 1) * size] * 2, np.linspace(0.0, height, up + 1), 1)
    sides = [np.arange(-beside, across + beside + 1) * size] * 2
    disk = _Block(kind, sides, np.linspace(-height / 2, 0.0, up // 2 + 1), blade.next_node)
    inner = [slice(beside, beside + across)] * 2
    surfaces = {
        "joint": (blade.faces(0), disk.faces(-1)[tuple(inner)]),
        "clamp": (disk.faces(0),),
        "tip": (blade.faces(-1),),
    }
    for number, (name, block) in enumerate((("blade", blade), ("disk", disk)), start=1):
        gmsh.model.addDiscreteEntity(3, number)
        gmsh.model.mesh.addNodes(3, number, block.tags.ravel(), block.places.reshape(-1, 3).ravel())
        gmsh.model.mesh.addElementsByType(number, CELLS[kind], [], block.cells.ravel())
        gmsh.model.setPhysicalName(3, gmsh.model.addPhysicalGroup(3, [number]), name)
    for number, (name, faces) in enumerate(surfaces.items(), start=1):
        gmsh.model.addDiscreteEntity(2, number)
        for some in faces:
            gmsh.model.mesh.addElementsByType(number, FACES[kind], [], some.ravel())
        gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, [number]), name)
    gmsh.model.mesh.reclassifyNodes()
    if order > 1:
        gmsh.model.mesh.setOrder(order)


class _Block:
    """Nodes and cells of a block; its faces at a level are ``(n_x, n_z, faces of a square, corners)``."""

    def __init__(self, kind: str, sides: list[np.ndarray], levels: np.ndarray, first: int):
        shape = len(sides[0]), len(levels), len(sides[1])
        self.kind = kind
        self.tags = first + np.arange(np.prod(shape)).reshape(shape)
        self.places = np.stack(np.meshgrid(sides[0], levels, sides[1], indexing="ij"), axis=-1)
        self.next_node = first + self.tags.size
        corner = {}
        for step in np.ndindex(2, 2, 2):
            corner[step] = self.tags[tuple(slice(s, n - 1 + s) for s, n in zip(step, shape, strict=True))]
        if kind == "hexahedra":
            round_ = [(0, 0), (1, 0), (1, 1), (0, 1)]
            self.cells = np.stack([corner[i, j, k] for k in (0, 1) for i, j in round_], axis=-1)
        else:
            self.cells = np.stack([self._follow(corner, order) for order in permutations(range(3))], axis=-2)

    @staticmethod
    def _follow(corner, order) -> np.ndarray:
        """Tetrahedra along the edges of a path from one corner of a cell to the opposite one."""
        at, path = np.zeros(3, dtype=int), [(0, 0, 0)]
        for axis in order:
            at[axis] = 1
            path.append(tuple(at.tolist()))
        steps = np.diff(np.array(path), axis=0)
        if np.linalg.det(steps) < 0:
            path[1], path[2] = path[2], path[1]
        return np.stack([corner[step] for step in path], axis=-1)

    def faces(self, level: int) -> np.ndarray:
        tags = self.tags[:, level]
        a, b, c, d = tags[:-1, :-1], tags[1:, :-1], tags[1:, 1:], tags[:-1, 1:]
        if self.kind == "hexahedra":
            return np.stack([a, b, c, d], axis=-1)[:, :, None]
        return np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=-2)
