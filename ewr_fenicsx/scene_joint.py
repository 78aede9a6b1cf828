"""The joint of a scene: which bodies and boundaries meet, under which laws; and flanks with laws of their own."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import model_validator
from pydantic_core import PydanticCustomError

from ewr_fenicsx.scene_entries import Number, Section, entry

Normal = Literal["unilateral", "bonded", "prescribed"]
Tangential = Literal["coulomb", "frictionless", "bonded"]
StaticFriction = Literal["resolved", "zero"]

# Entries that only one law reads: key -> (which law, its name)
READ_BY = {
    "normal_force": ("normal", "prescribed"),
    "initial_gap": ("normal", "unilateral"),
    "friction": ("tangential", "coulomb"),
    "static_friction": ("tangential", "coulomb"),
}


class Contact(Section):
    """The joint between two bodies and its laws."""

    body_a: str = entry("blade", "-", "The body whose outward normal counts.")
    body_b: str = entry("disk", "-", "The body it rests on.")
    flanks: tuple[str, ...] | None = entry(None, "-", "Boundaries in contact; by default all that both bodies share.")
    normal: Normal = entry(
        "unilateral", "-", "Normal law: contact with separation, no relative motion, or a given normal force."
    )
    tangential: Tangential = entry("coulomb", "-", "Tangential law.")
    friction: Number = entry(0.2, "-", "Coefficient of friction, for the law `coulomb`.", ge=0)
    static_friction: StaticFriction = entry(
        "resolved", "-", "Mean friction force: solved for, or set to zero as in the paper."
    )
    initial_gap: Number = entry(0.0, "m", "Initial clearance of every pair.", ge=0)
    normal_force: Number | None = entry(None, "N", "Normal force of every pair, for the law `prescribed`.", ge=0)
    pair_tolerance: Number = entry(
        1e-6, "-", "Largest distance of two paired nodes, relative to the flank's length.", gt=0
    )

    @model_validator(mode="after")
    def check_bodies(self) -> Contact:
        if self.body_a == self.body_b:
            raise PydanticCustomError("bodies", "body_a and body_b should differ; a body has no contact with itself")
        return self


class Flank(Section):
    """Laws of one flank where they differ from those in `[contact]`."""

    normal: Normal | None = entry(None, "-", "Normal law of this flank.")
    tangential: Tangential | None = entry(None, "-", "Tangential law of this flank.")
    friction: Number | None = entry(None, "-", "Coefficient of friction of this flank.", ge=0)
    static_friction: StaticFriction | None = entry(None, "-", "Mean friction force of this flank.")
    initial_gap: Number | None = entry(None, "m", "Initial clearance of this flank's pairs.", ge=0)
    normal_force: Number | None = entry(None, "N", "Normal force of each of this flank's pairs.", ge=0)
    wear: Number | None = entry(
        None, "1/Pa", "Wear coefficient of this flank in place of `[wear]`'s; 0: no wear.", ge=0
    )

    @property
    def laws(self) -> dict[str, Any]:
        """The entries on laws that were given."""
        return {key: value for key, value in self if value is not None and key != "wear"}
