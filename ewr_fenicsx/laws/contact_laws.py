"""What a user says of the laws at some pairs: one kind in the normal direction, one in the tangential ones.

The kinds themselves are one file each: ``unilateral.py``, ``bonded.py``, ``prescribed.py``, ``coulomb.py``. Importing
them here registers them; kinds of your own register themselves the same way (docs/adding_a_law.md).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import get_args

import numpy as np

from ewr_fenicsx.errors import ModelError, nearest
from ewr_fenicsx.given import ComplexArray, RealArray, keep, point_at, read_numbers, refreeze
from ewr_fenicsx.laws import bonded, coulomb, unilateral  # noqa: F401  register their kinds
from ewr_fenicsx.laws.law_kinds import Law, LawKind, PairGroup, Side, find_kind, list_parameters
from ewr_fenicsx.laws.mean_friction import StaticFriction
from ewr_fenicsx.laws.prescribed import Prescribed


@dataclass(frozen=True, eq=False)
class ContactLaws:
    """The laws of a set of pairs.

    Args:
        normal: ``"unilateral"`` (Signorini), ``"bonded"``, ``"prescribed"`` (``normal_force`` given, no gap), or the
            name of a kind registered elsewhere.
        tangential: ``"coulomb"``, ``"frictionless"``, ``"bonded"``, or the name of a kind registered elsewhere.
        friction: Coefficient of friction, scalar or ``(K,)``, one for each of its pairs in the group's order.
        normal_force: Prescribed normal force [N], scalar or ``(K,)``, or harmonic -> such amplitudes (complex).
        initial_gap: Clearance [m], scalar or ``(K,)``, negative an interference: bodies overlap by so much before
            their joint is put together, and press without any load. Wear adds to it.
        static_friction: What decides the mean friction force of pairs that stick throughout: ``"resolved"``, the least
            that their limits allow; ``"held"``, what holds them where they are without loads, as after a slow loading
            from rest. That of pairs that slip follows from the law either way. ``"zero"`` sets it to zero for all.
        parameters: Parameters of a kind registered elsewhere, name -> value; none of those above.

    Raises:
        ModelError: An unknown law or parameter, a negative friction, or a prescribed law without its force.
    """

    normal: str = "unilateral"
    tangential: str = "coulomb"
    friction: float | RealArray = 0.2
    normal_force: float | RealArray | Mapping[int, float | ComplexArray] | None = None
    initial_gap: float | RealArray = 0.0
    static_friction: StaticFriction = "resolved"
    parameters: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.static_friction not in (known := get_args(StaticFriction)):
            listed, hint = ", ".join(f'"{name}"' for name in known), nearest(self.static_friction, known)
            raise ModelError(f'static_friction = "{self.static_friction}"; choose one of {listed}{hint}')
        for name, least, must in (("friction", 0.0, "finite and not negative"), ("initial_gap", -np.inf, "finite")):
            value = read_numbers(name, getattr(self, name))
            if wrong := point_at(name, value, (value >= least) & np.isfinite(value)):
                raise ModelError(f"{wrong}; it must be {must}")
        if (find_kind("normal", self.normal) is Prescribed) != (self.normal_force is not None):
            raise ModelError('normal = "prescribed" goes with normal_force, and only with it; give both or neither')
        if not isinstance(self.parameters, Mapping):
            raise ModelError(f'parameters = {self.parameters!r}; give a dictionary such as {{"spring": 2e6}}')
        for name in ("friction", "normal_force", "initial_gap", "parameters"):
            object.__setattr__(self, name, keep(getattr(self, name)))
        self.kinds  # noqa: B018  mistakes in the parameters come to light here

    __setstate__ = refreeze

    @cached_property
    def kinds(self) -> tuple[LawKind, LawKind]:
        """The normal and the tangential kind, with their parameters.

        Raises:
            ModelError: A parameter that neither knows, or one that is missing.
        """
        classes = find_kind("normal", self.normal), find_kind("tangential", self.tangential)
        wanted = list_parameters("normal", self.normal), list_parameters("tangential", self.tangential)
        own = {f.name for f in fields(self) if f.name != "normal_force" or self.normal_force is not None}
        for name in self.parameters:
            if name in own:
                raise ModelError(f'parameters["{name}"] is an argument of its own; give {name} = ... in its place')
            if not any(name in names for names in wanted):
                known = sorted({*wanted[0], *wanted[1]})
                raise ModelError(
                    f'parameters["{name}"] is not known to normal = "{self.normal}" or tangential = "{self.tangential}"'
                    f"; they take {', '.join(known) or 'none'}{nearest(name, known)}"
                )
        said = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("normal", "tangential")}
        said |= self.parameters
        try:
            normal, tangential = (
                kind(**{name: said[name] for name in names if name in said})
                for kind, names in zip(classes, wanted, strict=True)
            )
        except TypeError as error:
            raise ModelError(
                f'normal = "{self.normal}", tangential = "{self.tangential}": {error}; give it in parameters={{...}}'
            ) from None
        return normal, tangential

    def build(self, group: PairGroup) -> list[Law]:
        """The laws of both kinds at some pairs.

        Raises:
            ModelError: A kind cannot use its parameters; names the kind.
        """
        laws: list[Law] = []
        for side, kind in zip(get_args(Side), self.kinds, strict=True):
            try:
                built = kind.build(group)
            except ModelError as error:
                raise ModelError(f'{side} = "{getattr(self, side)}": {error}') from None
            if not isinstance(built, Iterable):
                returned = f"{type(kind).__name__}.build returns one {type(built).__name__}"
                raise ModelError(f"{returned}; give a tuple of its laws, as (law,)")
            laws += built
        return laws


JointLaws = ContactLaws | Sequence[tuple[Sequence[int], ContactLaws]]  # for all pairs, or for groups of them
