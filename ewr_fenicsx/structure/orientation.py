"""Modes that come out alike from run to run: their signs, and their directions where several have one frequency."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from ewr_fenicsx.structure.columns import multiply

_EQUAL = 1e-7  # relative distance of frequencies up to which rounding mixes their modes


def group_equal(frequency: np.ndarray, known: np.ndarray | None = None) -> list[np.ndarray]:
    """Places of modes that share a frequency with others, group by group.

    Args:
        frequency: ``(m,)`` [Hz], rising.
        known: ``(m,)``, which modes stay as they are and are in no group; None: none.
    """
    places = np.arange(len(frequency)) if known is None else np.flatnonzero(~known)
    wide = np.diff(frequency[places]) > _EQUAL * np.abs(frequency[places][1:])
    return [group for group in np.split(places, np.flatnonzero(wide) + 1) if len(group) > 1]


def orient_modes(basis: np.ndarray, contacts: int, groups: list[np.ndarray], mass: PETSc.Mat) -> None:
    """Turns the modes in a basis by their inertial coupling with the contact nodes, whatever the numbering; collective.

    A mode by itself has a positive one with a pattern of the contact nodes' motion. Of m modes that share a
    frequency, any orthogonal mixture is as good: the second one has none with the first pattern, and so on.

    Args:
        basis: This rank's rows ``(rows, n)``; its modes are changed.
        contacts: Number of its first columns, which are no modes.
        groups: Places of modes that share a frequency, counted from the first mode.
        mass: Of all rows.
    """
    modes = basis[:, contacts:]
    phase = np.outer(np.arange(1, contacts + 1), np.arange(1, 1 + max(map(len, groups), default=1)))
    # weights that no symmetry of a geometry makes cancel
    inertia = multiply(mass, basis[:, :contacts] @ np.cos(phase))
    coupling = mass.comm.tompi4py().allreduce(modes.T @ inertia)
    signs = np.where(coupling[:, 0] < 0, -1.0, 1.0)
    for group in groups:
        mixture, triangle = np.linalg.qr(coupling[group, : len(group)])
        modes[:, group] = modes[:, group] @ mixture
        signs[group] = np.where(np.diag(triangle) < 0, -1.0, 1.0)
    modes *= signs
