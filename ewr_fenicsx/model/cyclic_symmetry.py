"""Cyclic symmetry: one sector of a ring of equal ones stands for all, each moving as the one before it did a while ago.

A load that travels round the ring, of engine order ``E``, reaches each of ``N`` sectors ``E / N`` of a period after the
one before, and so do the motions: at harmonic ``h`` the next sector has ``X_next = exp(-i h phi) X``, with
``phi = 2 pi E / N``. That is wave ``h E modulo N``, of as many nodal diameters, or of ``N`` less as many. Where
``A X + A_1 X_next + A_1^T X_before`` act on a sector, wave ``w`` sees the Hermitian matrix
``A + z A_1 + conj(z) A_1^T`` with ``z = exp(-2 pi i w / N)``. In wave 0 all sectors move in phase, as under the mean
load, whose wave it is. Pairs between a sector and the next one, as of shrouds, have rows ``B + z B_1``.

Source: Thomas (1979), Dynamics of rotationally periodic structures, doi:10.1002/nme.1620140106.
"""

from __future__ import annotations

import cmath
from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Integral
from urllib.parse import unquote

import h5py
import numpy as np

from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import ComplexArray, ReadOnly, RealArray, keep, read_numbers, refreeze

COUPLINGS = ("mass", "damping", "stiffness")
ROWS = ("normal", "tangential")
MOST_SECTORS, MOST_WAVES = 1000, 100_000


@dataclass(frozen=True, eq=False, repr=False)
class CyclicSymmetry:
    """How a sector hangs together with its neighbours, and how fast the load travels round.

    Args:
        sectors: How many there are in the ring, 2 or more, counted in the direction in which the next one lies.
        engine_order: How many waves of the load there are round the ring: at harmonic 1 each sector's load lags the one
            before by ``engine_order / sectors`` of a period. Negative where it travels the other way.
        mass, damping, stiffness: ``(n, n)`` real ``A_1``: what the next sector's motion does to this one
            [kg, N s/m, N/m]; what the motion of the one before does is the transpose.
        normal, tangential: What the next sector's coordinates add to the contact rows of the model, shaped as there;
            None: all pairs are within the sector.
        outputs: Name -> ``(n,)`` the same of the rows of outputs: of those that see the high cut.

    Raises:
        ModelError: No whole numbers, too few or too many of them, or couplings of different sizes or not finite.
    """

    sectors: int
    engine_order: int
    mass: RealArray
    damping: RealArray
    stiffness: RealArray
    normal: RealArray | None = None
    tangential: RealArray | None = None
    outputs: Mapping[str, RealArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("sectors", "engine_order"):
            value = getattr(self, name)
            if not isinstance(value, Integral) or isinstance(value, bool):
                raise ModelError(f"{name} = {value!r}; give a whole number")
            object.__setattr__(self, name, int(value))
        if not 2 <= self.sectors <= MOST_SECTORS:
            raise ModelError(f"sectors = {self.sectors}; a ring has 2 to {MOST_SECTORS}")
        if abs(self.engine_order) > MOST_WAVES:
            raise ModelError(f"engine_order = {self.engine_order}; give at most {MOST_WAVES} waves, either way")
        for name in COUPLINGS:
            matrix = read_numbers(f"{name} between sectors", getattr(self, name))
            if matrix.ndim != 2 or len(set(matrix.shape)) != 1 or not np.isfinite(matrix).all():
                raise ModelError(f"{name} between sectors has shape {matrix.shape}; give a finite square matrix")
            object.__setattr__(self, name, keep(matrix))
        for name in ROWS:
            if getattr(self, name) is not None:
                rows = np.atleast_2d(read_numbers(f"{name} of the next sector", getattr(self, name)))
                if rows.shape[1:] != (self.size,) or not np.isfinite(rows).all():
                    raise ModelError(f"{name} of the next sector has shape {rows.shape}; give finite (.., {self.size})")
                object.__setattr__(self, name, keep(rows))
        if len(sizes := {getattr(self, name).shape for name in COUPLINGS}) > 1:
            raise ModelError(f"mass, damping and stiffness between sectors have the shapes {sorted(sizes)}; give one")
        rows = {name: read_numbers(f"outputs[{name!r}] between sectors", row) for name, row in self.outputs.items()}
        for name, row in rows.items():
            if row.shape != (self.size,) or not np.isfinite(row).all():
                raise ModelError(f"outputs[{name!r}] between sectors: give {self.size} finite numbers")
        object.__setattr__(self, "outputs", ReadOnly({name: keep(row) for name, row in rows.items()}))

    __setstate__ = refreeze

    def __repr__(self) -> str:
        return f"CyclicSymmetry({self.sectors} sectors, engine order {self.engine_order})"

    @property
    def size(self) -> int:
        """Number of coordinates of a sector."""
        return self.stiffness.shape[0]

    @property
    def arrays(self) -> dict[str, RealArray]:
        """All that there are, by name."""
        return {name: getattr(self, name) for name in COUPLINGS + ROWS if getattr(self, name) is not None}

    def wave_of(self, harmonic: int) -> int:
        """The wave in which the sectors move at a harmonic, 0 to ``sectors - 1``."""
        return harmonic * self.engine_order % self.sectors

    def lag(self, wave: int) -> complex:
        """``X_next / X`` in a wave; exact where it is 1 or -1."""
        if 2 * wave % self.sectors == 0:
            return -1.0 if wave % self.sectors else 1.0
        return cmath.exp(-2j * cmath.pi * wave / self.sectors)

    def count_diameters(self, wave: int) -> int:
        """Nodal diameters of a wave, 0 to half the sectors."""
        return min(wave % self.sectors, -wave % self.sectors)

    def differ(self, name: str, wave: int) -> ComplexArray:
        """What a matrix has in a wave beyond what it has where all sectors are in phase, ``(n, n)`` Hermitian."""
        part = (self.lag(wave) - 1) * getattr(self, name)
        return part + part.conj().T

    def write(self, folder: h5py.Group) -> None:
        """Write all to an empty group of an HDF5 file."""
        folder.attrs.update(sectors=self.sectors, engine_order=self.engine_order)
        for name, value in self.arrays.items():
            folder[name] = value
        write_rows(folder.create_group("outputs"), self.outputs)


def read_cyclic_symmetry(folder: h5py.Group) -> CyclicSymmetry:
    """Read what ``CyclicSymmetry.write`` wrote."""
    arrays = {name: item[()] for name, item in folder.items() if isinstance(item, h5py.Dataset)}
    return CyclicSymmetry(**folder.attrs, **arrays, outputs=read_rows(folder["outputs"]))


def write_rows(folder: h5py.Group, entries: Mapping[object, np.ndarray]) -> None:
    """Write arrays to a group of an HDF5 file, by names of any kind."""
    for name, value in entries.items():
        folder[str(name).replace("%", "%25").replace("/", "%2F")] = value  # HDF5 takes "/" for a path


def read_rows(folder: h5py.Group) -> dict[str, np.ndarray]:
    """Read what ``write_rows`` wrote."""
    return {unquote(name): value[()] for name, value in folder.items()}
