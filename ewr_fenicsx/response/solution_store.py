"""Periodic solutions on disk and on their way between ranks: numbers only, the problem is stated anew."""

from __future__ import annotations

import hashlib
import inspect
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from numbers import Integral, Number, Real

import h5py
import numpy as np

from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.laws.contact_laws import ContactLaws
from ewr_fenicsx.laws.law_kinds import is_own
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.solution.solution import PeriodicSolution

_NUMBERS = {"converged": bool, "iterations": int, "residual": float, "seconds": float, "unknowns": int}
_WEIGHTS = ("rho_normal", "rho_tangential", "closure")
_CHOSEN = ("harmonics", "samples", *_WEIGHTS)  # solution by solution: by an accuracy, or in a fallback
_TEXTS = ("reason", "fallbacks", "left_out", "why_left_out", *_CHOSEN)


@dataclass(frozen=True, eq=False)
class Record:
    """A ``PeriodicSolution`` without its problem, but for what a solve may choose of it; attributes as there."""

    frequency: float
    harmonics: int | tuple[int, ...]
    samples: int | None
    rho_normal: float | tuple[float, ...] | None
    rho_tangential: float | tuple[float, ...] | None
    closure: str | tuple[float, ...]
    forces: ComplexArray
    rigid: RealArray
    converged: bool
    reason: str
    iterations: int
    fallbacks: tuple[str, ...]
    residual: float
    seconds: float
    unknowns: int
    left_out: tuple[int, ...]
    why_left_out: str


def strip(solution: PeriodicSolution) -> Record:
    """What must be kept of a solution to have it back with ``restore``."""
    problem = solution.problem
    stated = {name: _as_numbers(getattr(problem, name)) for name in _CHOSEN}
    kept = {f.name: getattr(solution, f.name) for f in fields(Record) if f.name not in ("frequency", *_CHOSEN)}
    return Record(frequency=problem.frequency, **stated, **kept)


def restore(problem: ContactProblem, record: Record) -> PeriodicSolution:
    """The solution that ``strip`` took apart, of ``problem`` with the harmonics, samples and weights that it had."""
    stated = {name: getattr(record, name) for name in _CHOSEN}
    if any(_as_numbers(getattr(problem, name)) != value for name, value in stated.items()):
        for name in _WEIGHTS:
            stated[name] = np.array(stated[name]) if isinstance(stated[name], tuple) else stated[name]
        problem = replace(problem, **stated)
    kept = {f.name: getattr(record, f.name) for f in fields(Record) if f.name not in ("frequency", *_CHOSEN)}
    return PeriodicSolution(problem, **kept)


def _as_numbers(value: object) -> float | str | tuple | None:
    """A number, a name or an array as what can be compared, and written as text to the last digit."""
    return value if value is None else _freeze(np.asarray(value).tolist())


def _freeze(value: object) -> object:
    return tuple(value) if isinstance(value, list) else value


def write_records(group: h5py.Group, records: Sequence[Record]) -> None:
    """Write records of one model and laws to an HDF5 group: one array for each attribute.

    Forces are ``(n, n_h, m)``, rows by the harmonics of each record; where it has fewer than others, the last are zero.
    """
    group["frequency"] = np.array([r.frequency for r in records])
    most = max((len(r.forces) for r in records), default=0)
    group["forces"] = np.array([np.pad(r.forces, ((0, most - len(r.forces)), (0, 0))) for r in records])
    for name in ("rigid", *_NUMBERS):
        group[name] = np.array([getattr(r, name) for r in records])
    for name in _TEXTS:
        group[name] = [json.dumps(getattr(r, name)) for r in records]


def read_records(group: h5py.Group) -> list[Record]:
    """Read what ``write_records`` wrote.

    Raises:
        OSError: A solution that converged is not finite: the file is damaged.
    """
    arrays = {name: group[name][()] for name in ("frequency", "forces", "rigid", *_NUMBERS)}
    found = arrays["converged"].astype(bool)
    if not all(np.isfinite(arrays[name][found]).all() for name in ("frequency", "forces", "rigid")):
        raise OSError(f"it is damaged: {group.name} holds solutions that are not finite")
    texts = {name: [_freeze(json.loads(text)) for text in group[name][()]] for name in _TEXTS}
    orders = [h + 1 if isinstance(h, int) else len(h) for h in texts["harmonics"]]
    return [
        Record(
            frequency=float(arrays["frequency"][i]),
            forces=arrays["forces"][i, : orders[i]],
            rigid=arrays["rigid"][i],
            **{name: kind(arrays[name][i]) for name, kind in _NUMBERS.items()},
            **{name: of_each[i] for name, of_each in texts.items()},
        )
        for i in range(len(arrays["frequency"]))
    ]


def fingerprint(*stated: object) -> str:
    """A digest of everything stated: numbers, texts, arrays, dataclasses, collections of these, code of own laws.

    Of numbers and sequences the type does not count, nor the order of a mapping.
    """
    digest = hashlib.sha256()
    _feed(digest.update, stated)
    return digest.hexdigest()


def _feed(update: Callable[[bytes], None], item: object) -> None:
    if isinstance(item, np.generic | np.ndarray) and not item.ndim:
        item = item.item()
    if isinstance(item, np.ndarray):
        item = item.astype(np.result_type(item, np.float64), copy=False) if item.dtype.kind in "iufc" else item
        update(f"{item.dtype}{item.shape}".encode())
        update(np.ascontiguousarray(item).tobytes())
    elif isinstance(item, Number) and not isinstance(item, bool):
        whole = isinstance(item, Integral) or (isinstance(item, Real) and float(item).is_integer())
        update(f"number {int(item) if whole else complex(item)}".encode())
    elif is_dataclass(item):
        update(type(item).__name__.encode())
        for entry in fields(item):
            update(entry.name.encode())
            _feed(update, getattr(item, entry.name))
        for kind in item.kinds if isinstance(item, ContactLaws) else ():
            if is_own(type(kind)):
                update(read_code(type(kind)).encode())
    elif isinstance(item, Mapping):
        update(f"mapping {len(item)}".encode())
        for key, value in sorted(item.items(), key=lambda entry: fingerprint(entry[0])):
            _feed(update, key)
            _feed(update, value)
    elif isinstance(item, list | tuple | range):
        update(f"sequence {len(item)}".encode())
        for value in item:
            _feed(update, value)
    else:
        update(f"{type(item).__name__} {item!r}".encode())


def read_code(kind: type) -> str:
    """Source of the file that a user's kind is from; "" where it was typed at a prompt.

    Of a script it is that of the classes only: what the script does with them may change.
    """
    module = sys.modules.get(kind.__module__)
    try:
        if kind.__module__ != "__main__":
            return inspect.getsource(module)
        own = [
            member for member in vars(module).values() if inspect.isclass(member) and member.__module__ == "__main__"
        ]
        return "".join(map(inspect.getsource, own))
    except (OSError, TypeError):
        return ""
