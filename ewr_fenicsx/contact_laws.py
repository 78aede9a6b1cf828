"""Contact laws as non-smooth equations at samples in time, with their generalised derivatives.

A law owns one contact direction of a set of pairs: one unknown force and one equation a pair and sample. It is told
forces, displacements and velocities at its pairs and answers with its residual (in newtons) and with the partial
derivatives that are not identically zero. Nothing outside this file knows stick from slip or open from closed.

Source: the equality-based form of the projections of Alart & Curnier (1991), doi:10.1016/0045-7825(91)90022-X.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import numpy as np

from ewr_fenicsx.errors import ModelError, nearest

RealArray = np.ndarray
ComplexArray = np.ndarray


@dataclass(frozen=True, eq=False)
class ContactLaws:
    """The laws of a set of pairs.

    Args:
        normal: ``"unilateral"`` (Signorini), ``"bonded"``, or ``"prescribed"`` (``normal_force`` given, no gap).
        tangential: ``"coulomb"``, ``"frictionless"`` or ``"bonded"``.
        friction: Coefficient of friction, scalar or ``(K,)``.
        normal_force: Prescribed normal force [N], scalar or ``(K,)``, or harmonic -> such amplitudes (complex).
        initial_gap: Clearance plus wear [m], scalar or ``(K,)``.
        static_friction: ``"resolved"`` finds the mean friction force of pairs that slip; ``"zero"`` sets it to zero.

    Raises:
        ModelError: An unknown law, a negative friction or gap, or a prescribed law without its force.
    """

    normal: str = "unilateral"
    tangential: str = "coulomb"
    friction: float | RealArray = 0.2
    normal_force: float | RealArray | Mapping[int, float | ComplexArray] | None = None
    initial_gap: float | RealArray = 0.0
    static_friction: str = "resolved"

    def __post_init__(self) -> None:
        for name, known in (
            ("normal", ("unilateral", "bonded", "prescribed")),
            ("tangential", ("coulomb", "frictionless", "bonded")),
            ("static_friction", ("resolved", "zero")),
        ):
            if (value := getattr(self, name)) not in known:
                choices = ", ".join(f'"{k}"' for k in known)
                raise ModelError(f'{name} = "{value}"; choose one of {choices}{nearest(value, known)}')
        for name in ("friction", "initial_gap"):
            value = np.asarray(getattr(self, name), dtype=float)
            if not np.all(value >= 0) or not np.all(np.isfinite(value)):
                raise ModelError(f"{name} = {getattr(self, name)}; it must be finite and not negative")
        if (self.normal == "prescribed") != (self.normal_force is not None):
            raise ModelError('normal = "prescribed" goes with normal_force, and only with it; give both or neither')


class Motion(NamedTuple):
    """What a law sees of its pairs at every sample: direction -> ``(n_t, K)`` arrays."""

    force: Mapping[str, RealArray]  # [N]
    displacement: Mapping[str, RealArray]  # [m]
    velocity: Mapping[str, RealArray]  # [m/s]


class Partial(NamedTuple):
    """One partial derivative of a law's residual, sample by sample."""

    variable: Literal["force", "displacement", "velocity"]
    direction: str
    values: RealArray  # (n_t, K)


class Response(NamedTuple):
    """A law's answer at every sample: ``(n_t, K)`` residual [N] and its generalised derivatives."""

    residual: RealArray
    partials: tuple[Partial, ...]


class Law(Protocol):
    """What the harmonic balance asks of a law.

    Attributes:
        direction: The contact direction that the law owns.
        pairs: ``(K,)`` pairs that it governs.
        static_row: Weight of the projected law in its mean equation (0 leaves the mean force to ``static_force_row``).
        static_force_row: Weight of the mean force in its mean equation.
        static_displacement_row: ``(K,)`` or scalar weight of the mean displacement in its mean equation [N/m].
        static_target: ``(K,)`` mean displacement at which the full-stick start holds the pair [m]; None: no mean force.
    """

    direction: str
    pairs: np.ndarray
    static_row: float
    static_force_row: float
    static_displacement_row: float | RealArray
    static_target: RealArray | None

    def evaluate(self, motion: Motion) -> Response:
        """Residual and generalised derivatives at every sample."""

    def fields(self, motion: Motion) -> dict[str, RealArray]:
        """What the law has to report besides its force: name -> ``(n_t, K)``."""


@dataclass(frozen=True, eq=False)
class Signorini:
    """Unilateral contact, ``lam_N + min(0, rho (q_N + g_0) - lam_N) = 0``.

    Args:
        pairs: ``(K,)`` pairs governed.
        initial_gap: ``(K,)`` initial clearance plus wear ``g_0`` [m].
        rho: ``(K,)`` positive weight [N/m].
    """

    pairs: np.ndarray
    initial_gap: RealArray
    rho: RealArray
    direction: str = "normal"
    static_row: float = 1.0
    static_force_row: float = 0.0
    static_displacement_row: float = 0.0

    @property
    def static_target(self) -> RealArray:
        return -self.initial_gap

    def evaluate(self, motion: Motion) -> Response:
        force = motion.force["normal"]
        pressed = self.rho * (motion.displacement["normal"] + self.initial_gap)
        closed = pressed < force
        return Response(
            np.where(closed, pressed, force),
            (
                Partial("force", "normal", np.where(closed, 0.0, 1.0)),
                Partial("displacement", "normal", np.where(closed, self.rho, 0.0)),
            ),
        )

    def fields(self, motion: Motion) -> dict[str, RealArray]:
        gap = motion.displacement["normal"] + self.initial_gap
        return {"gap": gap, "admissible_normal_force": np.maximum(0.0, motion.force["normal"] - self.rho * gap)}


@dataclass(frozen=True, eq=False)
class Bond:
    """No normal motion whatever the force, ``rho q_N = 0``: used where friction must know the force that bonds.

    Args:
        pairs: ``(K,)`` pairs governed.
        rho: ``(K,)`` positive weight [N/m].
    """

    pairs: np.ndarray
    rho: RealArray
    direction: str = "normal"
    static_row: float = 1.0
    static_force_row: float = 0.0
    static_displacement_row: float = 0.0

    @property
    def static_target(self) -> RealArray:
        return np.zeros(self.pairs.size)

    def evaluate(self, motion: Motion) -> Response:
        displacement = motion.displacement["normal"]
        stiffness = np.broadcast_to(self.rho, displacement.shape)
        return Response(stiffness * displacement, (Partial("displacement", "normal", stiffness),))

    def fields(self, motion: Motion) -> dict[str, RealArray]:
        return {"gap": motion.displacement["normal"]}


@dataclass(frozen=True, eq=False)
class Coulomb:
    """Dry friction in one tangential direction with the true, varying cone.

    ``lam_T - clip(lam_T - v / rho, -mu c, mu c) = 0`` with ``c = max(0, lam_N)``: the velocity-level
    dynamic-Lagrangian frequency-time method with penalty ``1 / rho``.

    Args:
        pairs: ``(K,)`` pairs governed.
        friction: ``(K,)`` coefficients of friction ``mu``.
        rho: ``(K,)`` positive weight [(m/s)/N].
        static_row, static_force_row: ``(1, eps)`` keeps the mean equation, regularised; ``(0, 1)`` sets mean friction
            to zero.
        static_displacement_row: ``(K,)`` or scalar; positive where only friction holds a body: pairs that stick
            throughout then share its mean load like springs [N/m].
    """

    pairs: np.ndarray
    friction: RealArray
    rho: RealArray
    static_row: float
    static_force_row: float
    static_displacement_row: float | RealArray = 0.0
    direction: str = "tangential"
    static_target: None = None

    def evaluate(self, motion: Motion) -> Response:
        force, velocity = motion.force["tangential"], motion.velocity["tangential"]
        normal = motion.force["normal"]
        limit = self.friction * np.maximum(0.0, normal)
        trial = force - velocity / self.rho
        forward, backward = trial >= limit, trial <= -limit
        slips = forward | backward
        cone = np.where(slips & (normal > 0), np.where(forward, -self.friction, self.friction), 0.0)
        return Response(
            force - project_on_cone(trial, limit),
            (
                Partial("force", "tangential", np.where(slips, 1.0, 0.0)),
                Partial("velocity", "tangential", np.where(slips, 0.0, 1 / self.rho)),
                Partial("force", "normal", cone),
            ),
        )

    def fields(self, motion: Motion) -> dict[str, RealArray]:
        normal = motion.force["normal"]
        trial = motion.force["tangential"] - motion.velocity["tangential"] / self.rho
        return {"admissible_friction_force": project_on_cone(trial, self.friction * np.maximum(0.0, normal))}


def project_on_cone(force: RealArray, limit: RealArray) -> RealArray:
    """Nearest friction force within the Coulomb limit, sample by sample.

    Args:
        force: Trial friction force, ``(n_t, K)`` [N].
        limit: ``mu max(0, lam_N)``, ``(n_t, K)`` [N].

    Returns:
        Admissible friction force, ``(n_t, K)`` [N].

    Raises:
        ModelError: A limit is negative or NaN; names the first sample and pair.

    Source: Alart & Curnier (1991), doi:10.1016/0045-7825(91)90022-X.
    """
    if not np.all(limit >= 0):
        sample, pair = np.argwhere(~(limit >= 0))[0]
        raise ModelError(
            f"friction limit {limit[sample, pair]} N at sample {sample} of pair {pair}; it must not be negative"
        )
    return np.clip(force, -limit, limit)


def prescribed_amplitudes(laws: ContactLaws, pairs: int) -> dict[int, ComplexArray]:
    """Harmonic -> ``(pairs,)`` amplitudes of the prescribed normal force [N]."""
    given = laws.normal_force if isinstance(laws.normal_force, Mapping) else {0: laws.normal_force}
    return {int(h): np.broadcast_to(np.asarray(a), (pairs,)) for h, a in given.items()}


def spread_over_pairs(value, pairs: np.ndarray, total: int) -> RealArray:
    """A scalar, a value for each pair of the model, or one for each pair of the group, as ``(K,)``.

    Raises:
        ModelError: None of these.
    """
    array = np.asarray(value, dtype=float)
    if array.ndim == 0:
        return np.full(pairs.size, float(array))
    if array.shape == (pairs.size,):
        return array
    if array.shape == (total,):
        return array[pairs]
    raise ModelError(f"{array.size} values for {pairs.size} pairs; give one, or one a pair")
