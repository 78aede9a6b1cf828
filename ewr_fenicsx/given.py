"""What a user gives, read once: numbers as arrays, counts and harmonics as whole numbers; or refused by name."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Real
from reprlib import repr as shorten

import numpy as np
import scipy.sparse

from ewr_fenicsx.errors import ModelError

RealArray = np.ndarray
ComplexArray = np.ndarray

_SYMMETRY = 1e-8  # largest asymmetry accepted, relative to the largest entry
_ROUNDED = 1e-15  # times the number of coordinates, of the largest entry: what rounding leaves of one that is zero


def read_numbers(name: str, value: object, kind: type = float, remedy: str = "give real numbers") -> np.ndarray:
    """A copy of some numbers as an array of one type, in the shape that they have.

    Args:
        name: What they are called.
        value: A number, a sequence, an array or a scipy sparse matrix.
        kind: ``float`` or ``complex``.
        remedy: What to do about complex numbers where ``kind`` is ``float``.

    Raises:
        ModelError: Something else than numbers, such as truth values; rows of unequal lengths, complex numbers where
            real ones belong, or entries that a mask hides.
    """
    if np.ma.is_masked(value):
        raise ModelError(f"{name} has entries that its mask hides; give a number for each, as masked.filled(0) does")
    try:
        array = np.array(value.toarray() if scipy.sparse.issparse(value) else value)
    except ValueError:
        raise ModelError(f"{name} = {shorten(value)} has rows of unequal lengths; make them equally long") from None
    if array.dtype.kind not in "iufc":
        instead = ", as np.flatnonzero makes of a mask" if array.dtype.kind == "b" else ""
        raise ModelError(f"{name} = {shorten(value)}; give numbers{instead}")
    if array.dtype.kind == "c" and kind is float:
        raise ModelError(f"{name} = {shorten(value)} is complex; {remedy}")
    return array.astype(kind, copy=False)


def point_at(name: str, values: np.ndarray, good: np.ndarray) -> str:
    """The first of some numbers that is not ``good``, by name and value: ``"friction[7] = nan"``; or ``""``."""
    if np.all(good):
        return ""
    at = np.unravel_index(np.argmin(good), np.shape(good))
    return f"{name}{list(map(int, at)) if at else ''} = {values[at]:g}"


def check_symmetry(name: str, matrix: RealArray) -> None:
    """That a matrix is symmetric.

    Raises:
        ModelError: It is not, or an entry that is more than rounding has none opposite.
    """
    asymmetry, largest = np.abs(matrix - matrix.T).max(), np.abs(matrix).max()
    if asymmetry > _SYMMETRY * largest:
        raise ModelError(
            f"{name} is not symmetric: largest difference {asymmetry:.3g}; symmetrise it or check its assembly"
        )
    alone = (matrix != 0) & (matrix.T == 0)
    if np.any(alone):  # where units are unlike, all of a triangle may be small beside the largest entry
        own = np.sqrt(np.abs(np.diag(matrix)))
        alone &= np.abs(matrix) > np.maximum(_SYMMETRY * np.outer(own, own), _ROUNDED * len(matrix) * largest)
    if np.any(alone):
        i, j = np.argwhere(alone)[0]
        raise ModelError(
            f"{name} is not symmetric: {name}[{i}, {j}] = {matrix[i, j]:g}, and {name}[{j}, {i}] = 0; give both "
            "triangles"
        )


class ReadOnly(dict):
    """A dictionary that nobody can write to: what a frozen owner keeps of one."""

    def _refuse(self, *_: object, **__: object) -> None:
        raise TypeError("models and problems are values: make another one with dataclasses.replace(...)")

    __setitem__ = __delitem__ = __ior__ = clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple:
        return ReadOnly, (dict(self),)


def keep(value: object) -> object:
    """What a frozen owner keeps of something given: arrays that nobody can write to, copied where somebody could."""
    if isinstance(value, np.ndarray):
        if value.flags.writeable or value.base is not None:
            value = np.array(value, subok=np.ma.is_masked(value))  # whoever reads it refuses what a mask hides
            value.flags.writeable = False
    elif isinstance(value, Mapping):
        return ReadOnly({key: keep(item) for key, item in value.items()})
    elif type(value) in (list, tuple):
        return type(value)(map(keep, value))
    return value


def refreeze(owner: object, state: Mapping[str, object]) -> None:
    """``__setstate__`` of a frozen owner: an array that was pickled can be written to."""
    for name, value in state.items():
        object.__setattr__(owner, name, keep(value))


def is_whole(value: object, least: int = 0) -> bool:
    """Whether something is a whole number, and not below ``least``."""
    return isinstance(value, Real) and value >= least and float(value).is_integer()


def is_positive(value: object) -> bool:
    """Whether something is a positive, finite number."""
    return isinstance(value, Real) and 0 < value < np.inf


def read_samples(samples: object) -> int:
    """A number of samples a period.

    Raises:
        ModelError: Not a whole number from 1.
    """
    if not is_whole(samples, 1):
        raise ModelError(f"samples = {samples!r}; give a whole number of samples a period, at least one")
    return int(samples)


def read_harmonic(name: str, harmonic: object) -> int:
    """The number of a harmonic, a key of what is given by harmonics.

    Raises:
        ModelError: Not a whole number from 0.
    """
    if not is_whole(harmonic):
        raise ModelError(f"{name} has a harmonic {harmonic!r}; harmonics are whole numbers from 0")
    return int(harmonic)
