"""The modes that small deviations are made of: of a structure, or of a ring of sectors wave by wave."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.model.receptance import NormalModes, find_undamped_modes
from ewr_fenicsx.problem.contact_system import ContactSystem

DAMPED = 0.5  # damping force over elastic force at the highest frequency, from which on a mode does not bend at once
ROUNDED = 1e-9  # damping of a mode over the largest, below which it is rounding


class Followed(NamedTuple):
    """The modes that deviations are made of, ``p`` of them, as ``m`` contact rows see them.

    Of waves in a ring of sectors complex, with a leading axis for these.
    """

    mass: RealArray  # (p, p)
    damping: RealArray | ComplexArray  # (p, p)
    stiffness: RealArray  # (p, p)
    rows: RealArray | ComplexArray  # (m, p)
    rest: RealArray | ComplexArray  # (m, m) flexibility by all other modes, which bend at once

    @property
    def count(self) -> int:
        """p."""
        return self.mass.shape[-1]

    def pick(self, waves: np.ndarray | int) -> Followed:
        """Those of some waves, by their places here, in turn; or of one."""
        return Followed(*(each[waves] for each in self))


def follow_modes(system: ContactSystem, reach: float) -> Followed:
    """The modes up to an angular frequency [rad/s], and those that damping holds up or feeds; or all coordinates.

    All where the stiffness is not positive.
    """
    model, rows = system.model, system.rows
    modes = find_undamped_modes(model)
    if modes is None:
        return Followed(model.mass, model.damping, model.stiffness, rows, np.zeros((len(rows),) * 2))
    damping = modes.shapes.T @ model.damping @ modes.shapes
    return _keep(modes, damping, rows, _find_followed(modes, damping, reach))


def follow_waves(system: ContactSystem, reach: float, waves: Iterable[int]) -> Followed:
    """The same of a ring of sectors, in each of some waves; as many modes in all of them.

    Raises:
        LinAlgError: The stiffness is not positive.
    """
    found = []
    for wave in waves:
        if (modes := find_undamped_modes(system.model, wave)) is None:
            raise np.linalg.LinAlgError("the stiffness is not positive")
        damping = modes.shapes.conj().T @ system.model.matrix("damping", wave) @ modes.shapes
        found.append((wave, modes, damping, _find_followed(modes, damping, reach)))
    count = max(np.count_nonzero(follows) for *_, follows in found)
    kept = []
    for wave, modes, damping, follows in found:
        slowest = np.argsort(-modes.mass, kind="stable")  # shapes have unit stiffness
        follows[slowest[~follows[slowest]][: count - np.count_nonzero(follows)]] = True
        kept.append(_keep(modes, damping, system.rows_in(wave), follows))
    return Followed(*map(np.array, zip(*kept, strict=True)))


def _find_followed(modes: NormalModes, damping: RealArray | ComplexArray, reach: float) -> np.ndarray:
    """Which modes move by themselves, up to an angular frequency [rad/s], or grow by themselves above it."""
    size = np.abs(damping)
    held_up = size.max(axis=1, initial=0.0) * reach > DAMPED  # of shapes with unit stiffness
    fed = np.diagonal(damping).real < -ROUNDED * size.max(initial=0.0)
    return (modes.mass * reach**2 >= modes.stiffness) | held_up | fed


def _keep(modes: NormalModes, damping: np.ndarray, rows: np.ndarray, follows: np.ndarray) -> Followed:
    """Some of the modes; the others bend at once."""
    left = rows @ modes.shapes[:, ~follows]
    return Followed(
        mass=np.diag(modes.mass[follows]),
        damping=damping[np.ix_(follows, follows)],
        stiffness=np.diag(modes.stiffness[follows]),
        rows=rows @ modes.shapes[:, follows],
        rest=left / modes.stiffness[~follows] @ left.conj().T,
    )
