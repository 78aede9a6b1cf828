"""Dynamic condensation: the motion at the contact rows as a function of the contact forces, harmonic by harmonic.

``q_h = H_h lam_h + q_h^f`` with ``H_h = B (K + i h w D - (h w)^2 M)^-1 B^T``; for floating bodies the mean motion has
in addition a rigid part ``G alpha`` and the forces must balance: ``G^T lam_0 + R^T f_0 = 0``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import scipy.linalg

from ewr_fenicsx.errors import ModelError, name_pairs
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.model.reduced_model import ReducedModel, bound_motion
from ewr_fenicsx.model.statics import list_most

GeneralisedInverse = Literal["inertia relief", "pinned"]
_SEEN = 1e-10  # motion of rows by rigid modes, over what they could see of them, below which it is rounding


@dataclass(frozen=True, eq=False)
class DynamicCompliance:
    """Compliance of ``m`` contact rows at ``n_h`` harmonics of one frequency.

    Attributes:
        omega: Angular frequency [rad/s].
        flexibility: ``(n_h, m, m)`` complex ``H_h`` [m/N].
        free_motion: ``(n_h, m)`` complex motion under the loads alone [m].
        rigid_motion: ``(m, r)`` motion of the rows by the rigid modes ``G``; each column's largest entry is 1.
            No columns where the mean is not among the harmonics.
        rigid_load: ``(r,)`` work of the mean load on the rigid modes [N].
        outputs: Name -> ``(n_h, m + 1 + r)`` complex: the output's reaction to row forces, to the load, to rigid modes.
    """

    omega: float
    flexibility: ComplexArray
    free_motion: ComplexArray
    rigid_motion: RealArray
    rigid_load: RealArray
    outputs: Mapping[str, ComplexArray]

    def motion(self, forces: ComplexArray, rigid: RealArray) -> ComplexArray:
        """Motion ``(n_h, m)`` of the rows [m] under forces ``(n_h, m)`` [N] and rigid coordinates ``(r,)``."""
        motion = np.matmul(self.flexibility, forces[:, :, None])[:, :, 0] + self.free_motion
        if rigid.size:
            motion[0] += self.rigid_motion @ rigid
        return motion

    def output(self, name: str, forces: ComplexArray, rigid: RealArray) -> ComplexArray:
        """One-sided amplitudes ``(n_h,)`` of an output under the same arguments as ``motion``.

        Raises:
            KeyError: The model has no output of that name.
        """
        row = self.outputs[name]
        m = forces.shape[1]
        amplitudes = np.einsum("hm,hm->h", row[:, :m], forces) + row[:, m]
        if rigid.size:
            amplitudes[0] += row[0, m + 1 :] @ rigid
        return amplitudes

    def bound_rows(self, forces: ComplexArray) -> RealArray:
        """``(n_h, m)`` what the rows' motion would reach, rigid motion aside, if no forces and loads cancelled."""
        moved = np.einsum("hij,hj->hi", np.abs(self.flexibility), np.abs(forces))
        return moved + np.abs(self.free_motion)

    def bound_output(self, name: str, forces: ComplexArray) -> RealArray:
        """``(n_h,)`` what an output would reach, rigid motion aside, if no forces ``(n_h, m)`` and loads cancelled.

        Raises:
            KeyError: The model has no output of that name.
        """
        row, m = np.abs(self.outputs[name]), forces.shape[1]
        return np.einsum("hm,hm->h", row[:, :m], np.abs(forces)) + row[:, m]


def condense(
    model: ReducedModel,
    rows: RealArray,
    load: Mapping[int, ComplexArray],
    omega: float,
    orders: tuple[int, ...],
    generalised_inverse: GeneralisedInverse = "inertia relief",
) -> DynamicCompliance:
    """Compliance of contact rows at the harmonics of one frequency, each computed once.

    Args:
        model: The reduced model.
        rows: ``(m, n)`` contact rows ``B``.
        load: Harmonic -> ``(n,)`` complex amplitude [N].
        omega: Angular frequency [rad/s], positive unless only the mean is asked for.
        orders: Harmonics.
        generalised_inverse: How the singular static stiffness of floating bodies is inverted; no result depends on it.

    Raises:
        ModelError: No positive frequency, a harmonic that hits an undamped mode exactly, or a rigid motion that the
            rows do not see.
    """
    if omega <= 0 and orders != (0,):
        raise ModelError(
            f"frequency = {omega / 2 / np.pi:g} Hz, with harmonics {orders} and loads at harmonics {sorted(load)}; "
            "give a positive frequency, or where nothing oscillates no load but that of harmonic 0"
        )
    m, names = rows.shape[0], list(model.outputs)
    found = _respond_at(model, _Itself(rows), omega, generalised_inverse)
    readers = found.readers
    modes = scale_rigid_modes(model, rows) if orders[0] == 0 else np.zeros((model.size, 0))
    responses = np.zeros((len(orders), readers.shape[0], m + 1), dtype=complex)
    for j, h in enumerate(orders):
        if m:
            responses[j, :, :m] = found.to_rows(h)
        if h in load:
            responses[j, :, m] = found.to_load(h, load[h])
    motion, rigid_load = readers @ modes, modes.T @ load.get(0, np.zeros(model.size)).real
    if modes.shape[1]:  # another generalised inverse, as valid: it keeps H_0 positive where few rows are closed
        stiffness = np.trace((motion @ motion.T)[:m, :m]) / max(np.trace(responses[0, :m, :m].real), 1e-300)
        work = np.column_stack([motion[:m].T, rigid_load])
        responses[0] += motion @ work / stiffness
    rigid = np.zeros((len(orders), readers.shape[0], modes.shape[1]))
    rigid[0] = motion
    return DynamicCompliance(
        omega=omega,
        flexibility=np.ascontiguousarray(responses[:, :m, :m]),
        free_motion=responses[:, :m, m].copy(),
        rigid_motion=rows @ modes,
        rigid_load=rigid_load,
        outputs={n: np.concatenate([responses[:, m + i], rigid[:, m + i]], axis=1) for i, n in enumerate(names)},
    )


class Responses:
    """What contact rows and outputs do under forces at one frequency: to those of the rows, each harmonic once.

    Problems that differ in weights, closure, laws' parameters, samples or in which harmonics they keep share them.

    Args:
        model, omega, generalised_inverse: As in ``condense``.
        rows: ``(m, n)`` contact rows.
    """

    def __init__(self, model: ReducedModel, rows: RealArray, omega: float, generalised_inverse: GeneralisedInverse):
        self.model, self.omega, self.generalised_inverse = model, omega, generalised_inverse
        self.readers = np.vstack([rows, *model.outputs.values()])
        self.rows = self.readers[: rows.shape[0]]
        self.modes = find_normal_modes(model)
        if self.modes is not None:
            self.seen = self.readers @ self.modes.shapes  # once for all harmonics
        self._known: dict[int, ComplexArray] = {}

    def to_rows(self, h: int) -> ComplexArray:
        """``(p, m)`` to unit forces at the rows, at a harmonic."""
        if h not in self._known:
            self._known[h] = self._respond_to_rows(h)
        return self._known[h]

    def to_load(self, h: int, force: ComplexArray) -> ComplexArray:
        """``(p,)`` to a load ``(n,)`` at a harmonic."""
        if self._uncouples(h):  # the fewest products first
            return self.seen @ (self.modes.gain(h * self.omega) * (self.modes.shapes.T @ force))
        return self._solve(h, force[:, None])[:, 0]

    def _respond_to_rows(self, h: int) -> ComplexArray:
        if self._uncouples(h):
            return superpose(self.seen, self.modes.gain(h * self.omega), self.seen[: len(self.rows)].T)
        return self._solve(h, self.rows.T)

    def _uncouples(self, h: int) -> bool:
        return self.modes is not None and (h != 0 or self.generalised_inverse != "pinned")

    def _solve(self, h: int, forces: ComplexArray) -> ComplexArray:
        return self.readers @ solve_directly(self.model, h * self.omega, forces, self.generalised_inverse)


@dataclass(frozen=True, eq=False)
class _Itself:
    """An array that equals itself alone: by what something is remembered."""

    array: RealArray

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Itself) and other.array is self.array

    def __hash__(self) -> int:
        return id(self.array)


@lru_cache(maxsize=2)  # as much memory as a compliance each
def _respond_at(model: ReducedModel, rows: _Itself, omega: float, generalised_inverse: GeneralisedInverse) -> Responses:
    return Responses(model, rows.array, omega, generalised_inverse)


@dataclass(frozen=True, eq=False)
class NormalModes:
    """Undamped modes of a reduced model: with them every frequency's compliance is one product.

    Scaled to unit stiffness rather than unit mass, so that massless coordinates are modes like others.

    Attributes:
        shapes: ``(n, n)``.
        stiffness, mass, damping: ``(n,)`` modal; stiffness exactly zero for rigid modes.
    """

    shapes: RealArray
    stiffness: RealArray
    mass: RealArray
    damping: RealArray

    def gain(self, omega: float | RealArray) -> ComplexArray:
        """``(n,)`` response of each mode to a unit of its force, ``(k, n)`` at ``k`` frequencies [rad/s].

        Rigid modes have none at zero frequency.

        Raises:
            ModelError: A frequency hits an undamped mode exactly.
        """
        omega = np.asarray(omega, dtype=float)[..., None]
        impedance = self.stiffness - omega**2 * self.mass + 1j * omega * self.damping
        responds = impedance != 0
        if np.any(hit := ~responds & (omega != 0)):
            raise hit_undamped_mode(np.broadcast_to(omega, hit.shape)[hit][0])
        return np.divide(1.0, impedance, where=responds, out=np.zeros_like(impedance))


def hit_undamped_mode(omega: float) -> ModelError:
    """What is wrong where nothing limits the response at a frequency [rad/s]."""
    return ModelError(f"{omega / (2 * np.pi):g} Hz hits an undamped mode exactly; give the model some damping")


@lru_cache(maxsize=8)
def find_normal_modes(model: ReducedModel) -> NormalModes | None:
    """All modes of the model, or None where they do not uncouple it: damping not proportional."""
    modes = find_undamped_modes(model)
    if modes is None:
        return None
    shapes, own = modes.shapes, modes.damping
    damping = shapes.T @ model.damping @ shapes
    rounding = 100 * np.finfo(float).eps * (np.abs(shapes).T @ np.abs(model.damping) @ np.abs(shapes))
    coupling = np.abs(damping) - 1e-8 * np.sqrt(np.abs(np.outer(own, own))) - rounding
    np.fill_diagonal(coupling, 0.0)
    return None if np.any(coupling > 0) else modes


@lru_cache(maxsize=8)
def find_undamped_modes(model: ReducedModel) -> NormalModes | None:
    """All modes of the model, whether damping couples them or not, or None where its stiffness is not positive.

    Solved as ``M phi = nu (K + c M) phi``, diagonally scaled: the low modes are then the large eigenvalues and keep
    their digits, whatever the highest frequency of the model.
    """
    weight = np.trace(model.mass)
    shift = (1e-6 * np.trace(model.stiffness) / weight or 1.0) if weight else 0.0  # without a mass nothing is rigid
    shifted = model.stiffness + shift * model.mass
    scale = 1 / np.sqrt(np.diag(shifted))
    try:
        mass, shapes = scipy.linalg.eigh(scale[:, None] * model.mass * scale, scale[:, None] * shifted * scale)
    except np.linalg.LinAlgError:
        return None
    shapes *= scale[:, None]
    stiffness = 1 - shift * mass
    stiffness[model.size - model.rigid_modes.shape[1] :] = 0.0  # ascending in mass: the rigid modes come last
    return NormalModes(shapes, stiffness, mass, np.einsum("ij,ij->j", shapes, model.damping @ shapes))


def receptance(model: ReducedModel, omega: float, readers: RealArray | None, forces: ComplexArray) -> ComplexArray:
    """``C Z(omega)^-1 F``: what rows ``C (p, n)`` read of the response to harmonic forces ``F (n, k)``.

    By modal superposition where the modes uncouple the model, else as ``solve_directly``. Without rows, all
    coordinates.

    Returns:
        ``(p, k)`` complex.

    Raises:
        ModelError: The frequency hits an undamped mode exactly.
    """
    read = (lambda response: response) if readers is None else (lambda response: readers @ response)
    modes = find_normal_modes(model)
    if modes is None:
        return read(solve_directly(model, omega, forces, "inertia relief"))
    return superpose(read(modes.shapes), modes.gain(omega), modes.shapes.T @ forces)


def solve_directly(
    model: ReducedModel, omega: float, forces: ComplexArray, generalised_inverse: GeneralisedInverse
) -> ComplexArray:
    """``Z(omega)^-1 F``: coordinates ``(n, k)`` under harmonic forces ``(n, k)``, by one factorisation of ``Z``.

    At zero frequency a generalised inverse, as in ``solve_static``.

    Raises:
        ModelError: The frequency hits an undamped mode exactly.
    """
    if omega == 0:
        return solve_static(model, forces, generalised_inverse)
    impedance = model.stiffness - omega**2 * model.mass + 1j * omega * model.damping
    try:
        return scipy.linalg.solve(impedance, forces, check_finite=False, overwrite_a=True)
    except np.linalg.LinAlgError:
        raise hit_undamped_mode(omega) from None


def measure_resistance(model: ReducedModel, rows: RealArray, omega: float) -> RealArray:
    """``(m,)`` flexibility ``b (K + omega^2 M)^-1 b^T`` of each row against stiffness and inertia together [m/N].

    Modes far below ``omega`` give little to it, however soft they are, and those far above all that they give at rest.
    """
    modes = find_undamped_modes(model)
    if modes is None:
        return np.einsum("mn,nm->m", rows, scipy.linalg.solve(model.stiffness + omega**2 * model.mass, rows.T))
    return (rows @ modes.shapes) ** 2 @ (1 / (modes.stiffness + omega**2 * modes.mass))


def superpose(read: RealArray, gain: ComplexArray, excited: ComplexArray) -> ComplexArray:
    """``(p, k)`` response that rows read ``(p, n)`` where each of ``n`` modes answers by its gain to ``(n, k)``."""
    if np.iscomplexobj(excited):
        return (read * gain) @ excited
    result = np.empty((read.shape[0], excited.shape[1]), dtype=complex)
    result.real = (read * gain.real) @ excited  # real products: half the work of complex ones
    result.imag = (read * gain.imag) @ excited
    return result


def solve_static(model: ReducedModel, forces: ComplexArray, generalised_inverse: GeneralisedInverse) -> ComplexArray:
    """``K^+ F``: static coordinates ``(n, k)``; for balanced forces the exact response up to a rigid motion.

    Args:
        model: The model, with ``r`` rigid modes.
        forces: ``(n, k)`` forces [N].
        generalised_inverse: ``"inertia relief"`` balances each force by d'Alembert forces and leaves no rigid motion;
            ``"pinned"`` holds ``r`` coordinates that the rigid modes move most independently.
    """
    modes = model.rigid_modes
    if modes.shape[1] == 0:
        return scipy.linalg.solve(model.stiffness, forces, assume_a="sym", check_finite=False)
    if generalised_inverse == "pinned":
        pins = scipy.linalg.qr(modes.T, pivoting=True, mode="r")[1][: modes.shape[1]]
        free = np.setdiff1d(np.arange(model.size), pins)
        response = np.zeros(forces.shape, dtype=forces.dtype)
        response[free] = scipy.linalg.solve(model.stiffness[np.ix_(free, free)], forces[free], assume_a="sym")
        return response
    modes = modes @ np.linalg.inv(np.linalg.cholesky(modes.T @ model.mass @ modes)).T
    inertia = model.mass @ modes
    stiff = np.abs(model.stiffness).max() or 1.0  # any will do where nothing bends
    grounded = model.stiffness + stiff / np.abs(inertia).max() ** 2 * (inertia @ inertia.T)
    balanced = forces - inertia @ (modes.T @ forces)
    response = scipy.linalg.solve(grounded, balanced, assume_a="sym", check_finite=False)
    return response - modes @ (inertia.T @ response)


def scale_rigid_modes(model: ReducedModel, rows: RealArray) -> RealArray:
    """Rigid modes ``(n, r)`` orthogonalised as the contact rows see them, each with a largest row motion of 1.

    Raises:
        ModelError: A rigid motion moves no contact row: nothing could ever hold it.
    """
    modes = model.rigid_modes
    if modes.shape[1] == 0:
        return modes
    motion = np.abs(rows @ modes).max(axis=0, initial=0.0)
    seen = motion > _SEEN * bound_motion(model, rows)
    modes = modes / np.where(seen, motion, np.inf)  # what is rounding must not become a motion
    _, values, turn = np.linalg.svd(rows @ modes, full_matrices=True)
    if rows.shape[0] < modes.shape[1] or values[-1] <= 1e-10 * max(values[0], 1e-300):
        share = turn[-1] / np.where(seen, motion, 1.0)
        raise ModelError(
            f"{modes.shape[1]} rigid motions of floating bodies, but the forces of contact tell only "
            f"{int((values > 1e-10 * values.max(initial=0.0)).sum())} of them apart: one that they do not see "
            f"{_tell_unseen(model, share)}"
        )
    modes = modes @ turn.T
    return modes / np.abs(rows @ modes).max(axis=0)


def _tell_unseen(model: ReducedModel, share: RealArray) -> str:
    """Which pairs a rigid motion moves that no unknown force sees, and what to do; ``share``: ``(r,)`` of the modes."""

    def list_moving(directions: Sequence[str]) -> list[int]:
        rows = [model.rows(direction) for direction in directions]
        moved = np.linalg.norm([along @ model.rigid_modes @ share for along in rows], axis=0)
        least = _SEEN * bound_motion(model, np.vstack(rows)) @ np.abs(share)
        return list_most(np.where(moved > least, moved, 0.0))

    if model.tangents and (slides := list_moving(model.tangent_directions)):
        told = f"slides along {name_pairs(slides)} without friction"
    elif model.normal is not None and (opens := list_moving(["normal"])):
        return (
            f"moves {name_pairs(opens)} along the normal, where forces are given and hold nothing; clamp the body, "
            'bond a flank, or let contact push back: normal = "unilateral"'
        )
    else:
        told = "moves no pair"
    return f"{told}; clamp the body, bond a flank, or add friction or pairs"
