"""The reduced model: all that the contact solver needs to know of a structure.

From here on nothing knows of meshes. Whoever has matrices from elsewhere starts with ``ReducedModel(...)``.

Conventions, for the whole package
    SI units; ``omega`` [rad/s] inside, frequencies in Hz where a user types them.
    ``x(tau) = Re sum_h X_h exp(i h tau)``, ``tau = omega t``; one-sided complex amplitudes, ``X_0`` real.
    Pair k joins a node of body A to one of body B; ``n`` is A's outward normal, ``t`` its tangent:
    ``q_N = (u_b - u_a).n`` (opening is positive), ``q_T = (u_a - u_b).t``.
    Pair forces: ``lam_N >= 0`` presses, ``lam_T`` is the friction force on A along ``t``.
    With ``q = B x``:  ``M x'' + D x' + K x = B^T lam + f(t)``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from reprlib import repr as shorten

import h5py
import numpy as np

from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import (
    ComplexArray,
    ReadOnly,
    RealArray,
    check_symmetry,
    keep,
    read_harmonic,
    read_numbers,
    refreeze,
)
from ewr_fenicsx.model.cyclic_symmetry import ROWS, CyclicSymmetry, read_cyclic_symmetry, read_rows, write_rows
from ewr_fenicsx.model.rigid_modes import (
    check_inertia,
    check_rigid_modes,
    find_precision,
    find_rigid_modes,
)
from ewr_fenicsx.whole_files import check_whole, replace_file

ARRAYS = ("mass", "damping", "stiffness", "normal", "tangential", "pair_area", "rigid_modes")  # of a model
_FORMAT = "ewr_fenicsx reduced model, 1"
_NEGATIVE = 1e-6  # most negative eigenvalue of the scaled mass accepted
_REMEDIES = {  # what to do about complex ones
    "stiffness": "give real matrices; structural damping belongs into damping, eta K / omega at its frequency",
    "normal": "give real rows, in real coordinates",
    "tangential": "give real rows, in real coordinates",
}
SMALLEST_LOAD, LARGEST_LOAD = 1e-100, 1e100  # [N] of all entries the largest: squares must stay numbers
_HELD = 1e-9  # of a rigid motion by neighbours, over the stiffness, below which it is rounding


@dataclass(frozen=True, eq=False, repr=False)
class ReducedModel:
    """Matrices, contact rows and loads of a structure in ``n`` coordinates.

    Args:
        mass, damping, stiffness: ``(n, n)`` real, dense or scipy sparse, kept dense [kg, N s/m, N/m]. Mass and
            stiffness are symmetric and positive semidefinite; damping need not be: skew parts are gyroscopic, negative
            ones feed a motion, as in flutter.
        normal: ``(K_c, n)`` rows with ``q_N = normal @ x`` [m]; None where no pair has a normal motion.
        tangential: ``(K_c, n)`` rows with ``q_T = tangential @ x`` [m], in 3-D ``(2 K_c, n)`` pair-major,
            for any two unit tangents at right angles; or None. By ``normal`` (zeros where a pair has no normal motion)
            the two of a pair are told from two pairs: without it, each row is a pair of its own. A row of zeros, in
            3-D that of the second tangent or both, is one along which nothing slides, as on a plane of symmetry.
        load: Harmonic -> ``(n,)`` complex force amplitude [N]; harmonic 0 real.
        pair_area: ``(K_c,)`` tributary area of each pair [m^2]; None: ones, which ``evolve_wear`` warns of.
        rigid_modes: ``(n, r)`` basis of the null space of ``stiffness``; found when None.
        outputs: Name -> ``(n,)`` row of a quantity to follow, ``row @ x``.
        cyclic: Of one sector of a ring: what its neighbours do to it; ``close_ring`` makes such models. All else is of
            this sector, and mass, damping and stiffness are those that it has while all sectors move in phase.

    Raises:
        ModelError: Shapes disagree, a matrix is not finite, symmetric or positive semidefinite, or ``rigid_modes``
            do not span the null space.
    """

    mass: RealArray
    damping: RealArray
    stiffness: RealArray
    normal: RealArray | None = None
    tangential: RealArray | None = None
    load: Mapping[int, ComplexArray] = field(default_factory=dict)
    pair_area: RealArray | None = None
    rigid_modes: RealArray | None = None
    outputs: Mapping[str, RealArray] = field(default_factory=dict)
    cyclic: CyclicSymmetry | None = None

    def __post_init__(self) -> None:
        freeze = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        precision = find_precision(self.stiffness)
        freeze("stiffness", _matrix("stiffness", self.stiffness))
        n = self.stiffness.shape[0]
        if self.stiffness.shape[1] != n:
            raise ModelError(f"stiffness has shape {self.stiffness.shape}; it must be square")
        if n == 0:
            raise ModelError("stiffness is empty; give a model with at least one coordinate")
        freeze("mass", _matrix("mass", self.mass, (n, n)))
        freeze("damping", _matrix("damping", self.damping, (n, n)))
        for name in ("mass", "stiffness"):
            check_symmetry(name, getattr(self, name))
        _check_mass(self.mass)
        if self.normal is None and self.tangential is None:
            raise ModelError("a reduced model needs contact rows: give normal, tangential or both")
        pairs = None
        if self.normal is not None:
            freeze("normal", _matrix("normal", self.normal, (None, n)))
            pairs = self.normal.shape[0]
        if self.tangential is not None:
            freeze("tangential", _matrix("tangential", self.tangential, (None, n)))
            rows = self.tangential.shape[0]
            if pairs is None:
                pairs = rows
            elif rows not in (pairs, 2 * pairs):
                raise ModelError(
                    f"tangential has {rows} rows for {pairs} pairs; give {pairs} (2-D) or {2 * pairs} (3-D, pair-major)"
                )
        if pairs == 0:
            raise ModelError(
                "the contact rows, normal and tangential, are empty; give a row for each pair, at least one"
            )
        if self.normal is None and self.pair_area is not None and 2 * np.size(self.pair_area) == pairs:
            raise ModelError(
                f"tangential has {pairs} rows for {pairs // 2} areas: without normal rows each is a pair of its own; "
                f"for two tangents a pair give normal as well, ({pairs // 2}, {n}) zeros where nothing moves so"
            )
        if self.pair_area is not None:
            freeze("pair_area", _vector("pair_area", self.pair_area, pairs))
            if not np.all(self.pair_area > 0):
                k = int(np.argmin(self.pair_area))
                raise ModelError(f"pair_area[{k}] = {self.pair_area[k]:g} m^2; every tributary area must be positive")
        freeze("load", check_loads(self.load, n))
        outputs = _mapping("outputs", self.outputs, '{"tip": row}')
        rows = {_name(name): _vector(f"outputs[{name!r}]", c, n) for name, c in outputs.items()}
        freeze("outputs", ReadOnly(rows))
        if self.rigid_modes is None:
            freeze("rigid_modes", keep(find_rigid_modes(self.stiffness, precision, self.mass)))
        else:
            modes = read_numbers("rigid_modes", self.rigid_modes)
            freeze("rigid_modes", _matrix("rigid_modes", modes[:, None] if modes.ndim == 1 else modes, (n, None)))
            freeze("stiffness", keep(check_rigid_modes(self.stiffness, self.mass, self.rigid_modes)))
        check_inertia(self.mass, self.stiffness, self.rigid_modes)
        if self.cyclic is not None:
            self._check_cyclic()

    __setstate__ = refreeze

    def __repr__(self) -> str:
        of = f", one of {self.cyclic.sectors} sectors" if self.cyclic else ""
        rigid = self.rigid_modes.shape[1]
        return f"ReducedModel({self.size} coordinates, {self.pairs} pairs, {rigid} rigid modes{of})"

    def _check_cyclic(self) -> None:
        if not isinstance(self.cyclic, CyclicSymmetry):
            raise ModelError(f"cyclic = {shorten(self.cyclic)}; give a CyclicSymmetry, as close_ring makes it, or None")
        if self.cyclic.size != self.size:
            raise ModelError(
                f"cyclic has matrices of {self.cyclic.size} coordinates, and the model {self.size}; give equal ones"
            )
        if unknown := self.cyclic.outputs.keys() - self.outputs.keys():
            raise ModelError(f"cyclic has outputs {sorted(unknown)} that the model does not have; give them rows there")
        check_symmetry("damping of a sector in a ring", self.damping)
        for name in ROWS:
            own, following = getattr(self, name), getattr(self.cyclic, name)
            if following is not None and (own is None or own.shape != following.shape):
                raise ModelError(f"cyclic: {name} of the next sector needs as many rows as {name} of the model has")
        for wave in {self.wave_of(1), self.cyclic.sectors // 2}:
            _check_mass(self.matrix("mass", wave))

    @property
    def size(self) -> int:
        """Number of coordinates ``n``."""
        return self.stiffness.shape[0]

    @property
    def pairs(self) -> int:
        """Number of contact pairs ``K_c``."""
        return (self.tangential if self.normal is None else self.normal).shape[0]

    @property
    def tangents(self) -> int:
        """Tangential directions a pair: 0, 1 (2-D) or 2 (3-D)."""
        return 0 if self.tangential is None else self.tangential.shape[0] // self.pairs

    @property
    def tangent_directions(self) -> tuple[str, ...]:
        """Names of the tangential directions."""
        return ("tangential", "second_tangential")[: self.tangents]

    def rows(self, direction: str, wave: int = 0) -> RealArray | ComplexArray:
        """Contact rows of a direction, ``(K_c, n)``; complex where pairs between sectors see a wave.

        Args:
            direction: ``"normal"``, ``"tangential"`` or, in 3-D, ``"second_tangential"``.
            wave: Of a ring.

        Raises:
            ModelError: The model has no rows of that direction.
        """
        if (own := _pick_rows(self, direction, self.tangents)) is not None:
            return self.see_wave(own, self.next_rows(direction) if self.joins_sectors else None, wave)
        raise ModelError(f"the law needs {direction} contact rows and the reduced model has none; give {direction}=...")

    def wave_of(self, harmonic: int) -> int:
        """The wave in which the sectors of a ring move at a harmonic; 0 where there is no ring."""
        return 0 if self.cyclic is None else self.cyclic.wave_of(harmonic)

    def tell_wave(self) -> str:
        """Of a ring, how many nodal diameters harmonic 1 has; words to follow on what it is said of."""
        if self.cyclic is None:
            return ""
        diameters = self.cyclic.count_diameters(self.wave_of(1))
        return f" in a wave of {diameters} nodal diameter{'s' * (diameters != 1)}"

    def matrix(self, name: str, wave: int = 0) -> RealArray | ComplexArray:
        """``"mass"``, ``"damping"`` or ``"stiffness"`` in a wave of the ring, ``(n, n)``: real in wave 0."""
        return getattr(self, name) if wave == 0 else getattr(self, name) + self.cyclic.differ(name, wave)

    def count_rigid(self, wave: int = 0) -> int:
        """How many rigid motions there are in a wave of the ring: of bodies that hang together with no neighbour."""
        count = self.rigid_modes.shape[1]
        if wave == 0 or not count:
            return count
        held = self.cyclic.differ("stiffness", wave) @ (self.rigid_modes / np.abs(self.rigid_modes).max(axis=0))
        return count - int(np.linalg.matrix_rank(held, tol=_HELD * np.abs(self.stiffness).max()))

    def read_outputs(self, wave: int = 0) -> RealArray | ComplexArray:
        """Rows of all outputs, ``(p, n)``; complex where they see a wave of the ring."""
        rows = np.array([*self.outputs.values()]).reshape(-1, self.size)
        if wave == 0 or not self.cyclic.outputs:
            return rows
        following = [self.cyclic.outputs.get(name, np.zeros(self.size)) for name in self.outputs]
        return self.see_wave(rows, np.array(following), wave)

    def see_wave(self, rows: RealArray, following: RealArray | None, wave: int) -> RealArray | ComplexArray:
        """Rows in a wave of the ring, by what they see in wave 0 and what of it is the next sector's, or nothing."""
        return rows if wave == 0 or following is None else rows + (self.cyclic.lag(wave) - 1) * following

    def react(self, name: str, amplitudes: ComplexArray, orders: Sequence[int]) -> ComplexArray:
        """Products of such a matrix with amplitudes ``(n_h, n)`` at harmonics ``orders``, each in its wave."""
        product = amplitudes @ getattr(self, name).T
        if self.cyclic is not None:
            lag = np.array([self.cyclic.lag(self.wave_of(h)) - 1 for h in orders])[:, None]
            coupling = getattr(self.cyclic, name)
            product = product + lag * (amplitudes @ coupling.T) + lag.conj() * (amplitudes @ coupling)
        return product

    @property
    def joins_sectors(self) -> bool:
        """Whether pairs are between this sector and the next one."""
        return self.cyclic is not None and any(getattr(self.cyclic, name) is not None for name in ROWS)

    def next_rows(self, direction: str) -> RealArray:
        """What the next sector's coordinates add to the rows of a direction, ``(K_c, n)``, of a ring."""
        found = _pick_rows(self.cyclic, direction, self.tangents)
        return np.zeros((self.pairs, self.size)) if found is None else found

    @property
    def areas(self) -> RealArray:
        """``pair_area``, ``(K_c,)`` [m^2]; ones where none was given."""
        return np.ones(self.pairs) if self.pair_area is None else self.pair_area

    def save(self, path: str | Path) -> None:
        """Write the model to an HDF5 file, replacing it, in a folder that is made where there is none.

        Raises:
            OutputError: The file cannot be written; what was there before stays.
        """
        with replace_file(Path(path)) as file:
            file.attrs["format"] = _FORMAT
            for name in ARRAYS:
                if (value := getattr(self, name)) is not None:
                    file[name] = value
            write_rows(file.create_group("load", track_order=True), self.load)
            write_rows(file.create_group("outputs", track_order=True), self.outputs)
            if self.cyclic is not None:
                self.cyclic.write(file.create_group("cyclic"))


def read_reduced_model(path: str | Path) -> ReducedModel:
    """Read a model that ``ReducedModel.save`` wrote; the same as ``ReducedModel.load(path)``.

    Raises:
        ModelError: There is no such file, or it was not written by ``ReducedModel.save``.
    """
    try:
        check_whole(Path(path))
        opened = h5py.File(path, "r")
    except OSError as error:
        why = error.strerror or error if Path(path).exists() else "there is no such file"
        raise ModelError(f"{path} is no reduced model: {why}; give a file that ReducedModel.save wrote") from None
    with opened as file:
        if file.attrs.get("format") != _FORMAT:
            raise ModelError(f'{path}: format "{file.attrs.get("format")}", expected "{_FORMAT}"; write it with save()')
        arrays = {name: item[()] for name, item in file.items() if isinstance(item, h5py.Dataset)}
        return ReducedModel(
            **arrays,
            load={int(h): f for h, f in read_rows(file["load"]).items()},
            outputs=read_rows(file["outputs"]),
            cyclic=read_cyclic_symmetry(file["cyclic"]) if "cyclic" in file else None,
        )


# The public interface calls both the field and the reader "load": an instance finds its field first, the class this.
ReducedModel.load = staticmethod(read_reduced_model)


def check_loads(load: Mapping[int, ComplexArray], size: int) -> dict[int, ComplexArray]:
    """Loads as read-only complex vectors: harmonic -> ``(size,)`` amplitudes [N].

    Raises:
        ModelError: No dictionary; a harmonic, a number of entries or a value that makes no sense; the mean load is not
            real.
    """
    given = _mapping("load", load, "{1: amplitudes}")
    loads = {read_harmonic("load", h): _load(h, f, size) for h, f in given.items()}
    largest = max((float(np.abs(f).max(initial=0.0)) for f in loads.values()), default=0.0)
    if largest and not SMALLEST_LOAD <= largest <= LARGEST_LOAD:
        raise ModelError(
            f"load: the largest entry is {largest:g} N; give {SMALLEST_LOAD:g} to {LARGEST_LOAD:g} N, whose squares "
            "are numbers, or none"
        )
    return ReadOnly(loads)


def _matrix(name: str, value, shape: tuple[int | None, int | None] = (None, None)) -> RealArray:
    matrix = np.atleast_2d(read_numbers(name, value, remedy=_REMEDIES.get(name, "give a real one")))
    expected = tuple("any" if s is None else s for s in shape)
    if matrix.ndim != 2 or any(s is not None and s != got for s, got in zip(shape, matrix.shape, strict=True)):
        raise ModelError(f"{name} has shape {matrix.shape}; expected ({expected[0]}, {expected[1]})")
    if not np.isfinite(matrix).all():
        raise ModelError(f"{name} has entries that are not finite")
    matrix.flags.writeable = False
    return matrix


def _vector(name: str, value, size: int, dtype=float) -> np.ndarray:
    vector = read_numbers(name, value, dtype).reshape(-1)
    if vector.shape != (size,):
        raise ModelError(f"{name} has {vector.size} entries; expected {size}")
    if not np.isfinite(vector).all():
        raise ModelError(f"{name} has entries that are not finite")
    vector.flags.writeable = False
    return vector


def _pick_rows(of: ReducedModel | CyclicSymmetry, direction: str, tangents: int) -> RealArray | None:
    if direction == "normal" or getattr(of, "tangential", None) is None:
        return of.normal if direction == "normal" else None
    first = {"tangential": 0, "second_tangential": 1}.get(direction, tangents)
    return of.tangential[first::tangents] if first < tangents else None


def _mapping(name: str, value: object, example: str) -> Mapping:
    if not isinstance(value, Mapping):
        raise ModelError(f"{name} = {shorten(value)}; give a dictionary such as {example}")
    return value


def _name(name: object) -> str:
    """An output's name, as files can hold it."""
    if (text := str(name)) in ("", ".") or "\0" in text:
        raise ModelError(f"outputs[{name!r}]: results go to files under that name, which none can have; give another")
    return text


def _load(h, amplitude, size: int) -> ComplexArray:
    vector = _vector(f"load[{h}]", amplitude, size, complex)
    if h == 0 and np.any(vector.imag != 0):
        raise ModelError("load[0] is the mean load and must be real")
    return vector


def _check_mass(mass: RealArray) -> None:
    """A Cholesky factorisation, which costs less than the eigenvalues: those are for the message."""
    diagonal = np.abs(np.diag(mass))
    floor = 1e-8 * np.abs(mass).max(initial=1e-300)  # rounding about massless coordinates stays small on this scale
    scale = 1 / np.sqrt(np.maximum(diagonal, floor))
    scaled = scale[:, None] * mass * scale
    try:
        np.linalg.cholesky(scaled + _NEGATIVE * np.eye(len(mass)))
    except np.linalg.LinAlgError:
        raise ModelError(
            f"mass is not positive semidefinite: scaled eigenvalue {np.linalg.eigvalsh(scaled)[0]:.3g}; check its "
            "sign and assembly"
        ) from None
