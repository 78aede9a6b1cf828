"""Response of a model's coordinates to harmonic forces: by its normal modes where these uncouple it, or directly.

Where sectors form a ring every harmonic is a wave of its own round it, with its own matrices and modes
(``cyclic_symmetry.py``); wave 0, of all sectors in phase, is the only one of other models.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, wraps
from typing import Literal

import numpy as np
import scipy.linalg

from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.model.reduced_model import ReducedModel
from ewr_fenicsx.model.rigid_modes import bound_rounding

GeneralisedInverse = Literal["inertia relief", "pinned"]
_SHIFT = 1e-6  # of eigenvalues, over the stiffness by the mass
_REMEMBERED, _MEMORY = 8, 2**30  # models; bytes for the waves of one, beyond which they are solved for every time


@dataclass(frozen=True, eq=False)
class NormalModes:
    """Undamped modes of a reduced model: with them every frequency's compliance is one product.

    Scaled to unit stiffness rather than unit mass, so that massless coordinates are modes like others.

    Attributes:
        shapes: ``(n, n)``; complex where they are waves.
        stiffness, mass, damping: ``(n,)`` modal; stiffness exactly zero for rigid modes.
    """

    shapes: RealArray | ComplexArray
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


def _remember_waves(find: Callable) -> Callable:
    """Remembers what is found of the last models, of each in all waves that fit: every frequency needs them again."""
    of_model = lru_cache(maxsize=_REMEMBERED)(lambda model: {})

    @wraps(find)
    def remembered(model: ReducedModel, wave: int = 0) -> NormalModes | None:
        known = of_model(model)
        if wave in known:
            return known[wave]
        found = find(model, wave)
        if (len(known) + 1) * 16 * model.size**2 <= max(_MEMORY, 16 * model.size**2):
            known[wave] = found
        return found

    return remembered


@_remember_waves
def find_normal_modes(model: ReducedModel, wave: int = 0) -> NormalModes | None:
    """All modes of the model in a wave, or None where they do not uncouple it: damping not proportional."""
    modes = find_undamped_modes(model, wave)
    if modes is None:
        return None
    shapes, own, matrix = modes.shapes, modes.damping, model.matrix("damping", wave)
    damping = shapes.conj().T @ matrix @ shapes
    rounding = 100 * np.finfo(float).eps * (np.abs(shapes).T @ np.abs(matrix) @ np.abs(shapes))
    coupling = np.abs(damping) - 1e-8 * np.sqrt(np.abs(np.outer(own, own))) - rounding
    np.fill_diagonal(coupling, 0.0)
    return None if np.any(coupling > 0) else modes


@_remember_waves
def find_undamped_modes(model: ReducedModel, wave: int = 0) -> NormalModes | None:
    """All modes in a wave, whether damping couples them or not, or None where the stiffness is not positive.

    Solved as ``M phi = nu (K + c M) phi``, diagonally scaled: the low modes are then the large eigenvalues and keep
    their digits, whatever the highest frequency of the model. Waves the other way round have conjugate shapes.
    """
    if wave and (opposite := model.cyclic.sectors - wave) < wave:
        modes = find_undamped_modes(model, opposite)
        return modes and replace(modes, shapes=modes.shapes.conj())
    inertia, stiffness, damping = (model.matrix(name, wave) for name in ("mass", "stiffness", "damping"))
    weight = np.trace(inertia).real
    shift = (_SHIFT * np.trace(stiffness).real / weight or 1.0) if weight else 0.0  # without a mass nothing is rigid
    shifted = stiffness + shift * inertia
    scale = 1 / np.sqrt(np.diag(shifted).real)
    try:
        mass, shapes = scipy.linalg.eigh(scale[:, None] * inertia * scale, scale[:, None] * shifted * scale)
    except np.linalg.LinAlgError:
        return None
    shapes *= scale[:, None]
    modal, rigid = 1 - shift * mass, model.count_rigid(wave)
    if wave and model.rigid_modes.size:  # a ring that may turn may shift as well, in a wave once round it
        rigid = max(rigid, np.count_nonzero(modal <= bound_rounding(model.size) / _SHIFT))
    modal[model.size - rigid :] = 0.0  # ascending in mass: the rigid modes come last
    return NormalModes(shapes, modal, mass, np.einsum("ij,ij->j", shapes.conj(), damping @ shapes).real)


def receptance(
    model: ReducedModel, omega: float, readers: RealArray | None, forces: ComplexArray, wave: int = 0
) -> ComplexArray:
    """``C Z(omega)^-1 F``: what rows ``C (p, n)`` read of the response to harmonic forces ``F (n, k)``.

    By modal superposition where the modes uncouple the model, else as ``solve_directly``. Without rows, all
    coordinates. Of a ring of sectors, in a wave round it.

    Returns:
        ``(p, k)`` complex.

    Raises:
        ModelError: The frequency hits an undamped mode exactly.
    """
    read = (lambda response: response) if readers is None else (lambda response: readers @ response)
    modes = find_normal_modes(model, wave)
    if modes is None:
        return read(solve_directly(model, omega, forces, "inertia relief", wave))
    return superpose(read(modes.shapes), modes.gain(omega), modes.shapes.conj().T @ forces)


def solve_directly(
    model: ReducedModel,
    omega: float,
    forces: ComplexArray,
    generalised_inverse: GeneralisedInverse,
    wave: int = 0,
) -> ComplexArray:
    """``Z(omega)^-1 F``: coordinates ``(n, k)`` under harmonic forces ``(n, k)``, by one factorisation of ``Z``.

    At zero frequency a generalised inverse, as in ``solve_static``.

    Raises:
        ModelError: The frequency hits an undamped mode exactly.
    """
    if omega == 0:
        return solve_static(model, forces, generalised_inverse)
    stiffness, mass, damping = (model.matrix(name, wave) for name in ("stiffness", "mass", "damping"))
    impedance = stiffness - omega**2 * mass + 1j * omega * damping
    try:
        return scipy.linalg.solve(impedance, forces, check_finite=False, overwrite_a=True)
    except np.linalg.LinAlgError:
        raise hit_undamped_mode(omega) from None


def measure_resistance(model: ReducedModel, rows: RealArray, omega: float, wave: int = 0) -> RealArray:
    """``(m,)`` flexibility ``b (K + omega^2 M)^-1 b^T`` of each row against stiffness and inertia together [m/N].

    Modes far below ``omega`` give little to it, however soft they are, and those far above all that they give at rest.
    """
    modes = find_undamped_modes(model, wave)
    if modes is None:
        impedance = model.matrix("stiffness", wave) + omega**2 * model.matrix("mass", wave)
        return np.einsum("mn,nm->m", rows, scipy.linalg.solve(impedance, rows.conj().T)).real
    return np.abs(rows @ modes.shapes) ** 2 @ (1 / (modes.stiffness + omega**2 * modes.mass))


def measure_at_rest(model: ReducedModel, rows: RealArray, wave: int = 0) -> RealArray:
    """``(m,)`` static flexibility of each row by itself, rigid motions left out [m/N]."""
    modes = find_undamped_modes(model, wave) if wave else None
    if modes is None:
        return np.diag(receptance(model, 0.0, rows, rows.T)).real.copy()
    bends = modes.stiffness > 0
    return np.abs(rows @ modes.shapes[:, bends]) ** 2 @ (1 / modes.stiffness[bends])


def superpose(read: RealArray | ComplexArray, gain: ComplexArray, excited: ComplexArray) -> ComplexArray:
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
