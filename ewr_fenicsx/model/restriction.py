"""A reduced model on some of its motions only: with bonds, with fewer modes, or with its joint stuck."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg

from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.model.cyclic_symmetry import COUPLINGS, ROWS
from ewr_fenicsx.model.reduced_model import ReducedModel
from ewr_fenicsx.model.rigid_modes import find_own_units

_STILL = 1e-10  # of what the coordinates could move a row by, below which it is at rest but for rounding
_ROUNDINGS = 10  # times the number of coordinates, that a projection leaves of an entry that is zero


def restrict(model: ReducedModel, basis: RealArray, rigid_modes: RealArray) -> ReducedModel:
    """The model on the motions ``x = basis @ y``.

    Args:
        model: The model.
        basis: ``(n, n')``, independent columns.
        rigid_modes: ``(n', r)`` those of the model's that are among these motions, as ``y``.
    """
    units = find_own_units(model.stiffness, model.mass)
    project = lambda rows: None if rows is None else _project_rows(rows, basis)  # noqa: E731
    symmetric = lambda matrix: 0.5 * (matrix + matrix.T)  # noqa: E731
    cyclic = model.cyclic
    if cyclic is not None:
        projected = {name: basis.T @ getattr(cyclic, name) @ basis for name in COUPLINGS}
        projected |= {name: project(getattr(cyclic, name)) for name in ROWS}
        cyclic = replace(cyclic, **projected, outputs={name: basis.T @ c for name, c in cyclic.outputs.items()})
    return replace(
        model,
        mass=symmetric(_project(model.mass, basis, units)),
        damping=basis.T @ model.damping @ basis,
        stiffness=symmetric(_project(model.stiffness, basis, units)),
        normal=project(model.normal),
        tangential=project(model.tangential),
        load={h: basis.T @ f for h, f in model.load.items()},
        outputs={name: basis.T @ c for name, c in model.outputs.items()},
        rigid_modes=rigid_modes,
        cyclic=cyclic,
    )


def solve_stuck(
    model: ReducedModel, wave: int = 0, count: int | None = None
) -> tuple[RealArray, RealArray | ComplexArray]:
    """Squared angular frequencies ``(k,)``, rising, and mass-normalised shapes ``(n, k)`` of full stick, in a wave.

    Args:
        model: Of the open joint.
        wave: Of a ring.
        count: How many, at most; None: all.
    """
    stuck = scipy.linalg.null_space(
        np.vstack([model.rows(direction, wave) for direction in ("normal", *model.tangent_directions)])
    )
    stiffness, mass = (stuck.conj().T @ model.matrix(name, wave) @ stuck for name in ("stiffness", "mass"))
    subset = None if count is None else (0, min(count, stuck.shape[1]) - 1)
    values, vectors = scipy.linalg.eigh(stiffness, mass, subset_by_index=subset)
    return values, stuck @ vectors


def find_bond_forces(
    model: ReducedModel, bonds: Sequence[tuple[str, np.ndarray]], left: ComplexArray
) -> list[ComplexArray]:
    """Forces that make up for what the others leave over, ``(n, k)`` [N]: ``(K, k)`` for each direction and pairs held.

    The least of them where bonds are redundant.
    """
    rows = np.vstack([model.rows(direction)[pairs] for direction, pairs in bonds])
    units = find_own_units(model.stiffness, model.mass)[:, None]
    forces = np.linalg.lstsq(rows.T / units, left / units, rcond=1e-12)[0]
    return np.split(forces, np.cumsum([pairs.size for _, pairs in bonds])[:-1])


def bound_motion(model: ReducedModel, rows: RealArray) -> RealArray:
    """``(r,)`` motion that rows could see of each rigid mode: far less than this is rounding.

    By Cauchy and Schwarz, in units of which the coordinates' own ones drop out.
    """
    root = find_own_units(model.stiffness, model.mass)
    seen = np.linalg.norm(rows / root, axis=1).max(initial=0.0)
    return seen * np.linalg.norm(root[:, None] * model.rigid_modes, axis=0)


def _project_rows(rows: RealArray, basis: RealArray) -> RealArray:
    """``rows @ basis``; rows that bonds hold are zero, without the rounding that would count as their motion."""
    seen = rows @ basis
    reached = np.linalg.norm(np.abs(rows) @ np.abs(basis), axis=1, keepdims=True)
    return np.where(np.linalg.norm(seen, axis=1, keepdims=True) > _STILL * reached, seen, 0.0)


def _project(matrix: RealArray, basis: RealArray, units: RealArray) -> RealArray:
    """``basis^T A basis`` without its rounding, which would count as mass or stiffness where a motion is free of it.

    What is rounding, the stiffness's own ``units`` ``(n,)`` tell, for those of the coordinates may be unlike.
    """
    own, moved = matrix / units[:, None] / units, units[:, None] * basis
    sizes = np.linalg.norm(moved, axis=0)
    moved = moved / sizes
    forces, eps = np.abs(own).sum(axis=1), np.finfo(float).eps  # each entry of the basis is off by about eps
    reached = np.abs(moved).T @ forces + eps * forces.sum()
    projected, rounding = moved.T @ own @ moved, _ROUNDINGS * len(own) * eps * np.add.outer(reached, reached)
    return np.where(np.abs(projected) > rounding, projected, 0.0) * sizes[:, None] * sizes
