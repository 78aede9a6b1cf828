"""The reduced models that the benchmarks share, and what they need to know of them."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import scipy.linalg

from ewr_fenicsx import ReducedModel
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.problem.layout import hold

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))

from small_models import dovetail  # noqa: E402

__all__ = [
    "blade_root",
    "damp",
    "dovetail",
    "find_first_mode",
    "lap_joint",
    "shake",
    "take_step",
    "two_blocks",
    "two_trusses",
]


@lru_cache(maxsize=8)
def blade_root(pairs: int = 10) -> ReducedModel:
    """The demo's blade root: a floating blade on four flanks of ``pairs`` pairs each; the rest of the mesh stays."""
    from ewr_fenicsx import build_reduced_model, load_scene  # dolfinx and gmsh only for those who want this model

    scene = load_scene(ROOT / "demos" / "blade_root.toml")
    if pairs != 10:
        geometry = scene.geometry.model_copy(update={"parameters": {**scene.geometry.parameters, "pairs": pairs}})
        scene = scene.model_copy(update={"geometry": geometry})
    return build_reduced_model(scene)


@lru_cache(maxsize=1)
def two_blocks() -> ReducedModel:
    """The demo's block that is pressed on another one and shaken sideways: it rocks, and shaken hard it jumps."""
    from ewr_fenicsx import build_reduced_model, load_scene

    return build_reduced_model(load_scene(ROOT / "demos" / "two_blocks.toml"))


def lap_joint(*, pairs: int = 7, preload: float = 700.0, excitation: complex = 5.0) -> ReducedModel:
    """Two cantilevers, clamped at opposite ends, that overlap and are pressed together: neither floats.

    Steel beams of 200 mm by 6 mm by 20 mm, the upper one clamped at its left, the lower one at its right, twelve
    elements each (axial and bending), overlapping by half of their length. The contact line runs between them, half a
    height off their axes: bending slides and opens it. Bolts press the pairs together, more towards the upper beam's
    free end, which is shaken, mostly across. First full-stick mode near 370 Hz.
    """
    young, density, width, height, length, elements = 210e9, 7850.0, 0.02, 0.006, 0.2, 12
    area, inertia, h = width * height, width * height**3 / 12, length / elements
    axial = young * area / h * np.array([[1.0, -1.0], [-1.0, 1.0]])
    bending = (
        young
        * inertia
        / h**3
        * np.array(
            [
                [12, 6 * h, -12, 6 * h],
                [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                [-12, -6 * h, 12, -6 * h],
                [6 * h, 2 * h**2, -6 * h, 4 * h**2],
            ]
        )
    )
    swing = (
        density
        * area
        * h
        / 420
        * np.array(
            [
                [156, 22 * h, 54, -13 * h],
                [22 * h, 4 * h**2, 13 * h, -3 * h**2],
                [54, 13 * h, 156, -22 * h],
                [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
            ]
        )
    )
    stretch = density * area * h / 6 * np.array([[2.0, 1.0], [1.0, 2.0]])
    dofs = 3 * (elements + 1)  # of one beam: u, w, rotation at every node
    stiffness, mass = np.zeros((2 * dofs, 2 * dofs)), np.zeros((2 * dofs, 2 * dofs))
    for first in (0, dofs):
        for e in range(elements):
            node = first + 3 * e
            along, across = [node, node + 3], [node + 1, node + 2, node + 4, node + 5]
            stiffness[np.ix_(along, along)] += axial
            stiffness[np.ix_(across, across)] += bending
            mass[np.ix_(along, along)] += stretch
            mass[np.ix_(across, across)] += swing
    # the lower beam's left end lies under the middle of the upper one; pairs at the upper one's nodes, free end first
    upper = np.arange(elements, elements - pairs, -1)
    if not 1 <= pairs <= elements // 2 + 1:
        raise ValueError(f"pairs = {pairs}; the overlap has 1 to {elements // 2 + 1} nodes")
    lower = upper - elements // 2
    normal, tangential = np.zeros((pairs, 2 * dofs)), np.zeros((pairs, 2 * dofs))
    for k, (a, b) in enumerate(zip(upper, lower, strict=True)):
        a, b = 3 * a, dofs + 3 * b
        normal[k, a + 1], normal[k, b + 1] = 1.0, -1.0
        tangential[k, [a, a + 2, b, b + 2]] = 1.0, height / 2, -1.0, height / 2
    static, harmonic, tip = np.zeros((3, 2 * dofs))
    bolts = np.linspace(2.0, 1.0, pairs)
    static -= normal.T @ (preload * bolts / bolts.sum())
    harmonic[dofs - 2], harmonic[dofs - 3] = excitation, 0.3 * excitation
    tip[dofs - 2] = 1.0
    free = np.setdiff1d(np.arange(2 * dofs), [0, 1, 2, 2 * dofs - 3, 2 * dofs - 2, 2 * dofs - 1])
    on_free = lambda matrix: matrix[np.ix_(free, free)]  # noqa: E731
    model = ReducedModel(
        mass=on_free(mass),
        damping=0.0 * on_free(mass),
        stiffness=on_free(stiffness),
        normal=normal[:, free],
        tangential=tangential[:, free],
        load={0: static[free], 1: harmonic[free]},
        pair_area=np.full(pairs, h * width),
        outputs={"tip": tip[free]},
    )
    return damp(model, 5e-3)


def two_trusses(pairs: int, load: float, seed: int = 1) -> ReducedModel:
    """Two plane trusses that face each other along a line, both held, pressed together by a constant load and shaken.

    In units of a typical spring, a head's mass and the preload; the contact nodes of a body weigh 0.02 together.
    Coordinates: of each body (x, y) of its ``pairs`` contact nodes, then of its two heads, which springs hold; x is
    tangential, y normal. The upper body's heads are pressed, the first one is shaken by ``load`` and read.
    """
    rng = np.random.default_rng(seed)
    nodes = pairs + 2
    half = 2 * nodes
    stiffness, mass = np.zeros((2 * half, 2 * half)), np.zeros(2 * half)
    for body, side in enumerate((1.0, -1.0)):
        line = [[2.0 * (k + 0.5) / pairs - 1.0, 0.0] for k in range(pairs)]
        place = np.array([*line, [-1.5, 2.0 * side], [1.5, 2.0 * side]])
        first = body * half
        for i in range(nodes):
            for j in range(i):
                axis = (place[i] - place[j]) / np.linalg.norm(place[i] - place[j])
                row = np.zeros(2 * half)
                row[first + 2 * i : first + 2 * i + 2], row[first + 2 * j : first + 2 * j + 2] = axis, -axis
                stiffness += rng.uniform(0.7, 1.3) * np.outer(row, row) / np.sqrt(pairs)
        heads = np.arange(first + half - 4, first + half)
        stiffness[heads, heads] += rng.uniform(0.5, 1.5, 4) * (0.02 if body == 0 else 1.0)
        mass[first : first + half - 4], mass[heads] = 0.02 / pairs, 1.0
    normal, tangential = np.zeros((pairs, 2 * half)), np.zeros((pairs, 2 * half))
    for k in range(pairs):
        normal[k, [2 * k + 1, half + 2 * k + 1]] = 1.0, -1.0
        tangential[k, [2 * k, half + 2 * k]] = 1.0, -1.0
    head = half - 4
    static, harmonic, tip = np.zeros(2 * half), np.zeros(2 * half, dtype=complex), np.zeros(2 * half)
    static[[head + 1, head + 3]], harmonic[head], harmonic[head + 1], tip[head] = -0.5, load, 0.5j * load, 1.0
    return ReducedModel(
        mass=np.diag(mass),
        damping=0.03 * (stiffness + np.diag(mass)),
        stiffness=stiffness,
        normal=normal,
        tangential=tangential,
        load={0: static, 1: harmonic},
        outputs={"tip": tip},
    )


def shake(model: ReducedModel, factor: float) -> ReducedModel:
    """The model with its oscillating loads times a factor; the constant ones stay."""
    return replace(model, load={h: force * (factor if h else 1.0) for h, force in model.load.items()})


def take_step(balance: HarmonicBalance, unknowns: np.ndarray, *, all_rows: bool = False) -> None:
    """One Newton step; with all rows in it, none eliminated, it is the worst that any state can cost."""
    linear = balance.linearise(unknowns)
    if all_rows:
        linear.__dict__["steady"] = np.zeros(balance.rows, dtype=bool)
    linear.solve(linear.residual)


def find_first_mode(model: ReducedModel) -> float:
    """Frequency of the first mode with every pair stuck and closed [Hz]."""
    stuck, _ = hold(model, np.vstack([model.normal, model.tangential]))
    return float(np.sqrt(scipy.linalg.eigh(stuck.stiffness, stuck.mass, eigvals_only=True)[0]) / 2 / np.pi)


def damp(model: ReducedModel, ratio: float, first: float | None = None) -> ReducedModel:
    """The model with Rayleigh damping: ``ratio`` at ``first`` [Hz] or the first full-stick mode, half from the mass."""
    omega = 2 * np.pi * (find_first_mode(model) if first is None else first)
    drag = lambda part: ratio * (omega * part.mass + part.stiffness / omega)  # noqa: E731
    ring = model.cyclic
    return replace(model, damping=drag(model), cyclic=ring and replace(ring, damping=drag(ring)))
