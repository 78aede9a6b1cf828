"""What a contact law is, and the register of their kinds: all that the rest of the package knows of them.

Two small classes make a law. The *kind* holds what a user said of some pairs (a name and its parameters): which
contact directions carry an unknown force, which motions are held, what it has to report. The *law* is the equation of
one direction at samples in time. Nothing else in the package knows which kinds exist: to add one, write the two classes
and register the kind (docs/adding_a_law.md).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar, Literal, NamedTuple, Protocol, TypeVar, get_args

import numpy as np

from ewr_fenicsx.errors import ModelError, UnknownSignal, nearest
from ewr_fenicsx.given import ComplexArray, RealArray, read_numbers

Side = Literal["normal", "tangential"]
DIRECTIONS = ("normal", "tangential", "second_tangential")  # of contact rows, in their order
TANGENTS = DIRECTIONS[1:]  # in the plane of contact: the first one alone in 2-D
Variable = Literal["force", "force_rate", "displacement", "oscillation", "velocity", "acceleration"]


@dataclass(frozen=True, eq=False)
class Signal(Mapping[str, RealArray]):
    """One variable at a law's pairs, direction -> ``(n_t, K)``, computed when it is looked at.

    Args:
        at_rows: Computes the variable at all rows, ``(n_t, m)``.
        columns: Direction -> ``(K,)`` rows of the pairs.
        given: Direction -> what computes it at the pairs where no row has it, ``(n_t, K)``.
    """

    at_rows: Callable[[], RealArray]
    columns: Mapping[str, np.ndarray | slice]
    given: Mapping[str, Callable[[], RealArray]] = field(default_factory=dict)

    def __getitem__(self, direction: str) -> RealArray:
        if direction in self.given:
            return self.given[direction]()
        if direction not in self.columns:
            known = ", ".join(f'"{name}"' for name in self) or "none"
            raise UnknownSignal(
                f'a law asks for a "{direction}" signal of its pairs, which see {known} of that variable: forces that '
                "are given, not sought, have no motion"
            )
        return self.at_rows()[:, self.columns[direction]]

    def __iter__(self) -> Iterator[str]:
        return iter((*self.columns, *self.given))

    def __len__(self) -> int:
        return len(self.columns) + len(self.given)


class Motion(NamedTuple):
    """What a law sees of its pairs at every sample: direction -> ``(n_t, K)`` arrays, computed when looked at."""

    force: Mapping[str, RealArray]  # [N]
    displacement: Mapping[str, RealArray]  # [m]
    velocity: Mapping[str, RealArray]  # [m/s]
    force_rate: Mapping[str, RealArray] = MappingProxyType({})  # [N/s]
    oscillation: Mapping[str, RealArray] = MappingProxyType({})  # displacement less its mean [m]
    acceleration: Mapping[str, RealArray] = MappingProxyType({})  # [m/s^2]


class Partial(NamedTuple):
    """One partial derivative of a law's residual, sample by sample; of a law that remembers, it may reach back.

    Attributes:
        variable, direction: What it is by.
        values: ``(n_t, K)``.
        since: ``(n_t, K)`` sample ``j`` of which ``values[j]`` times the variable counts here, -1: none. None: its own.
        kept: ``(n_t, K)`` share of a momentum kept from sample to sample, ``u_i = kept_i u_(i-1) + values_i x_i``, of
            which ``u_i - u_(i-1)`` and the mean times ``2 pi / n_t`` count here. None: there is none.
    """

    variable: Variable
    direction: str
    values: RealArray
    since: np.ndarray | None = None
    kept: RealArray | None = None


class Response(NamedTuple):
    """A law's answer at every sample: ``(n_t, K)`` residual [N] and its generalised derivatives."""

    residual: RealArray
    partials: tuple[Partial, ...]


class Law(Protocol):
    """The equation of one contact direction of some pairs: one unknown force and one equation a pair and sample.

    Attributes:
        direction: The contact direction that the law owns.
        pairs: ``(K,)`` pairs that it governs.
        static_row: Weight of the projected law in its mean equation (0 leaves the mean force to ``static_force_row``).
        static_force_row: Weight of the mean force in its mean equation.
        static_displacement_row: ``(K,)`` or scalar weight of the mean displacement in its mean equation [N/m]; only a
            law with a partial derivative by its own velocity or oscillation may have one.
        static_target: ``(K,)`` mean displacement at which the full-stick start holds the pair [m]; None: no mean force.
        stick_flexibility: ``(K,)`` or scalar flexibility of the law itself in the full-stick start [m/N].
        linear: Whether the residual is linear in all that the law sees: where every law is, nothing is iterated.
        closes: What closes its truncation in place of a weight, ``"springs"`` or ``"masses"``; "": nothing does.
        opposes: The motion that the force opposes, ``"displacement"`` or ``"velocity"``, where the law is a projection:
            ``force = admit(force - c motion)`` with any positive ``c``. A cold start then finds its way more quickly
            (``splitting.py``); "": it is none.
        impedance: ``(K,)`` that ``c`` of the weighted residual, force over motion; where a force opposes a velocity and
            springs close its truncation, their stiffness [N/m]; None: it has none, and the start is less near.
        has_corners: Whether the residual is linear in what the law sees but for corners, which ``find_corners`` and
            ``differentiate`` tell. Hard cases then find their way where Newton's method stalls (``newton_path.py``).

    A law with a weight from ``PairGroup.weight`` has it, ``(K,)``, in a field ``rho``, without a default here that
    would get in the way of other fields: by it costs and errors are estimated, and weights far off are approached.
    """

    direction: str
    pairs: np.ndarray
    static_row: float = 1.0
    static_force_row: float | RealArray = 0.0
    static_displacement_row: float | RealArray = 0.0
    static_target: RealArray | None = None
    stick_flexibility: float | RealArray = 0.0
    linear: bool = False
    closes: str = ""
    opposes: str = ""
    impedance: RealArray | None = None
    has_corners: bool = False

    def evaluate(self, motion: Motion) -> Response:
        """Residual and generalised derivatives at every sample."""
        raise NotImplementedError

    def find_corners(self, motion: Motion) -> Sequence[RealArray]:
        """Functions ``(n_t, K)``, linear in what the law sees, between whose zeros its residual is linear."""
        raise NotImplementedError

    def differentiate(self, sides: Sequence[np.ndarray]) -> tuple[Partial, ...]:
        """Derivatives where these functions are positive or not, ``(n_t, K)`` bool each; also at some samples only."""
        raise NotImplementedError

    def admit(self, trial: Mapping[str, RealArray]) -> RealArray:
        """The admissible force ``(n_t, K)`` nearest to a trial force, direction -> ``(n_t, K)`` [N].

        Forces of the other side (normal, tangential) are what the law has to take as they are.
        """
        raise NotImplementedError

    def fields(self, motion: Motion) -> dict[str, RealArray]:
        """What the law has to report besides its force: name -> ``(n_t, K)``.

        Four names have a meaning for all: ``"open"`` and ``"slipping"``, bool, say in which state each pair is;
        ``"surface_slip"``, up to a constant, is what slides and wears where that is not the truncated slip [m];
        ``"admissible_normal_force"`` is what presses and wears where that is not the truncated force [N]. What the law
        of a second tangent reports is known with ``"second_"`` before its name.
        """
        return {}

    def rounded(self, width: float) -> Law:
        """The law with its corners rounded over forces of about ``width`` [N]; a smooth law is its own."""
        return self


def choose_friction_weight(omega: float, flexibility: RealArray) -> RealArray:
    """Default weight ``rho_T = omega d`` of rows of a flexibility ``d``, ``(K,)`` [(m/s)/N]."""
    return omega * flexibility


@dataclass(frozen=True, eq=False)
class PairGroup:
    """The pairs on which a kind lays its laws, and the problem's scales there.

    Attributes:
        pairs: ``(K,)`` numbers of the pairs.
        total: Pairs of the whole model, ``K_c``.
        flexibility: Direction with an unknown force -> ``(K,)`` static flexibility [m/N].
        weight: Direction -> ``(K,)`` weight ``rho`` that the user chose, or the default: [N/m] on the normal
            displacement, [(m/s)/N] on tangential velocities.
        closing: Tangential direction -> ``(K,)`` flexibility of springs that close the truncation [m/N]; zero: none.
        closing_mass: The same of masses [kg]. Where there are neither, dashpots, the weights, close it.
        clearance: ``(K,)`` initial gap plus wear [m].
        period: Of the motion [s]; 0 where nothing oscillates.
        hangs_on_friction: Whether a floating body is held by nothing but friction.
        stated: ``(K0,)`` pairs for which the kind was stated, among them these, in the same order.
    """

    pairs: np.ndarray
    total: int
    flexibility: Mapping[str, RealArray]
    weight: Mapping[str, RealArray]
    closing: Mapping[str, RealArray]
    closing_mass: Mapping[str, RealArray]
    clearance: RealArray
    period: float
    hangs_on_friction: bool
    stated: np.ndarray

    def spread(self, value: float | RealArray) -> RealArray:
        """A parameter (one value, one a pair of the stated ones or one a pair of the model) as ``(K,)``."""
        return spread_over_pairs(value, self.stated, self.total)[np.isin(self.stated, self.pairs)]


class MeanBound(NamedTuple):
    """Mean force that a kind can carry: from smallest to largest, and ``friction`` x the normal force either way."""

    smallest: float | RealArray  # [N]
    largest: float | RealArray  # [N]
    friction: float | RealArray = 0.0


class LawKind(Protocol):
    """A kind of law with its parameters: a frozen dataclass whose fields are the parameters' names.

    Everything has a default that suits a kind without rows, so a kind says only what is special about it.

    Attributes:
        effect: What people call the effect that this kind brings; "" for its class's name.
        histories: Names of the histories that mean something where this kind rules.
        needs: Directions whose force its laws must know.
        slides: Whether pairs slip where no law says so; else they stick.
        opens: Whether the pairs may part: there is a gap, to which wear adds.
        only_pushes: Whether its normal forces never pull and take no energy: where they do, truncation is coarse.
        odd: Whether the laws' residual changes sign with the forces and motions that they see; forces given from
            outside apart.
        blind_to_mean: Whether a mean displacement changes nothing in the laws.
        rests: Whether a pair whose row of the model is zero along a tangent, as on a plane of symmetry, goes without
            a force there. Else such a pair is refused.
        initial_gap: Clearance [m], scalar or ``(K,)``; negative: interference.
        friction: Coefficient of a Coulomb cone, scalar or ``(K,)``; zero where there is none.
    """

    effect: ClassVar[str] = ""
    histories: ClassVar[tuple[str, ...]] = ()
    needs: ClassVar[tuple[str, ...]] = ()
    slides: ClassVar[bool] = False
    opens: ClassVar[bool] = False
    only_pushes: ClassVar[bool] = False
    odd: ClassVar[bool] = False
    blind_to_mean: ClassVar[bool] = False
    rests: ClassVar[bool] = False
    initial_gap = 0.0
    friction = 0.0

    def acts_in(self, tangents: int) -> tuple[str, ...]:
        """Directions in which each pair has an unknown force; ``tangents`` is 0, 1 (2-D) or 2 (3-D)."""
        return ()

    def holds(self, tangents: int) -> tuple[str, ...]:
        """Directions without motion: projected out of the model, unless the other kind needs their force."""
        return ()

    def give_force(self, spread: Callable[[float | ComplexArray], ComplexArray]) -> Mapping[int, ComplexArray]:
        """Harmonic -> ``(K,)`` amplitudes of a normal force that is given, not sought [N]; ``spread`` makes them so."""
        return {}

    def bound_mean(self, spread: Callable[[float | RealArray], RealArray]) -> MeanBound:
        """Mean force that it can carry; ``spread`` makes a parameter ``(K,)``."""
        return MeanBound(0.0, 0.0)

    def build(self, group: PairGroup) -> Iterable[Law]:
        """The laws of these pairs: one for each direction with an unknown force."""
        return ()


Kind = TypeVar("Kind", bound=type)
_KINDS: dict[tuple[str, str], type] = {}


def register_law(side: Side, name: str) -> Callable[[Kind], Kind]:
    """Makes a kind known by name, ``ContactLaws(normal=name)`` or ``(tangential=name)``; decorates the class.

    Raises:
        ModelError: No such side, or another kind has that name.
    """
    if side not in (sides := get_args(Side)):
        raise ModelError(f'register_law("{side}", "{name}"): choose one of {", ".join(sides)}{nearest(side, sides)}')

    def enter(kind: Kind) -> Kind:
        known = _KINDS.setdefault((side, name), kind)
        if (known.__module__, known.__qualname__) != (kind.__module__, kind.__qualname__):
            raise ModelError(
                f'{side} = "{name}" is {known.__module__}.{known.__qualname__} already; choose another name'
            )
        _KINDS[side, name] = kind
        return kind

    return enter


def load_laws(source: Path) -> None:
    """Runs a Python file that registers kinds of its own; run again, its kinds take the place of the former ones.

    Raises:
        ModelError: No Python file.
        Exception: What the file raises when it is run.
    """
    if source.suffix != ".py":
        raise ModelError("give a Python file, NAME.py")
    name = f"_laws_{source.resolve()}"  # files of other folders may have the same name
    specification = spec_from_file_location(name, source)
    module = sys.modules[name] = module_from_spec(specification)  # dataclasses look up the module that defines them
    specification.loader.exec_module(module)


def list_parameters(side: Side, name: str) -> tuple[str, ...]:
    """Names of the parameters that a kind takes.

    Raises:
        ModelError: Nothing of that name is registered, or no dataclass.
    """
    kind = find_kind(side, name)
    if not is_dataclass(kind):
        raise ModelError(
            f'{side} = "{name}": {kind.__qualname__} is no dataclass; write @dataclass(frozen=True) above it'
        )
    return tuple(f.name for f in fields(kind))


def is_own(kind: type) -> bool:
    """Whether a kind, by its class, is not the package's but a user's."""
    return not kind.__module__.startswith("ewr_fenicsx.")


def known_laws(side: Side) -> tuple[str, ...]:
    """Names of the kinds registered for a side, in the order of their registration."""
    return tuple(name for at, name in _KINDS if at == side)


def find_kind(side: Side, name: str) -> type:
    """The class of a kind by its name.

    Raises:
        ModelError: Nothing of that name is registered; names what is.
    """
    if not isinstance(name, str) or (side, name) not in _KINDS:
        known = known_laws(side)
        choices = ", ".join(f'"{law}"' for law in known)
        raise ModelError(f'{side} = "{name}"; choose one of {choices}{nearest(name, known)}')
    return _KINDS[side, name]


def spread_over_pairs(value, pairs: np.ndarray, total: int, name: str = "", kind: type = float) -> np.ndarray:
    """A scalar, a value for each pair of the model, or one for each pair of the group, as ``(K,)``.

    ``name`` is what it is called where it is refused; ``kind`` is ``float`` or ``complex``.

    Raises:
        ModelError: None of these.
    """
    array = read_numbers(name or "a parameter", value, kind)
    if array.ndim == 0:
        return np.full(pairs.size, array)
    if array.shape == (pairs.size,):
        return array
    if array.shape == (total,):
        return array[pairs]
    said = f"{name} has " if name else ""
    size = f"{array.size} values" if array.ndim == 1 else f"the shape {array.shape}"
    raise ModelError(f"{said}{size} for {pairs.size} pairs; give one, or one a pair")
