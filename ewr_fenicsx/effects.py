"""Which physical effects a scene calls for, and why: what `ewr info` tells."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from ewr_fenicsx.scene import ForceLoad, RotationLoad, Scene


@dataclass(frozen=True)
class Effect:
    """One physical effect: whether a scene has it, and why."""

    name: str
    on: bool
    why: str


def list_effects(scene: Scene) -> Iterator[Effect]:
    """The effects that a scene has and has not, in the order in which they enter the problem."""
    contact = scene.contact
    law = lambda key: f'contact.{key} = "{getattr(contact, key)}"'  # noqa: E731
    static = [name for name, load in scene.loads.items() if isinstance(load, ForceLoad) and load.harmonic == 0]
    harmonic = [name for name, load in scene.loads.items() if load.harmonic > 0]
    rotation = [name for name, load in scene.loads.items() if isinstance(load, RotationLoad)]
    listed = lambda names: "loads " + ", ".join(names) if names else "no such load"  # noqa: E731
    yield Effect("separation", contact.normal == "unilateral", law("normal"))
    yield Effect("prescribed preload", contact.normal == "prescribed", law("normal"))
    coulomb = contact.tangential == "coulomb" and contact.friction > 0
    yield Effect("friction", coulomb, law("tangential") + (f", friction = {contact.friction:g}" if coulomb else ""))
    yield Effect("static friction", coulomb and contact.static_friction == "resolved", law("static_friction"))
    yield Effect(
        "bonded parts", "bonded" in (contact.normal, contact.tangential), f"{law('normal')}, {law('tangential')}"
    )
    yield Effect("initial gap", contact.initial_gap > 0, f"contact.initial_gap = {contact.initial_gap:g} m")
    yield Effect("static load", bool(static), listed(static))
    yield Effect("centrifugal load", bool(rotation), listed(rotation))
    yield Effect("harmonic load", bool(harmonic), listed(harmonic))
    yield Effect("odd harmonics only", all(h % 2 for h in scene.harmonics), f"harmonics {list(scene.harmonics)}")
