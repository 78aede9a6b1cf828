"""The joint of a scene: which bodies and boundaries meet, under which laws; and flanks with laws of their own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field, ValidationInfo, WithJsonSchema, field_validator, model_validator
from pydantic_core import PydanticCustomError

from ewr_fenicsx.errors import nearest, tell_mistake
from ewr_fenicsx.laws import contact_laws  # noqa: F401  registers the package's own laws
from ewr_fenicsx.laws.law_kinds import Side, find_kind, is_own, known_laws, load_laws
from ewr_fenicsx.laws.mean_friction import StaticFriction
from ewr_fenicsx.scene.scene_entries import Number, Section, entry


def _check_law(side: Side) -> Callable[[str], str]:
    def check(name: str) -> str:
        if name not in (known := known_laws(side)):
            choices = ", ".join(f"'{law}'" for law in known)
            message = "should be one of {choices}, or of a law that contact.law_files register{hint}"
            raise PydanticCustomError("law", message, {"choices": choices, "hint": nearest(name, known)})
        return name

    return check


# editors complete the package's own laws, and take others
Normal = Annotated[
    str,
    AfterValidator(_check_law("normal")),
    WithJsonSchema({"anyOf": [{"enum": ["unilateral", "bonded", "prescribed"]}, {"type": "string"}]}),
]
Tangential = Annotated[
    str,
    AfterValidator(_check_law("tangential")),
    WithJsonSchema({"anyOf": [{"enum": ["coulomb", "frictionless", "bonded"]}, {"type": "string"}]}),
]
Parameters = dict[str, Any]

# Entries that not every law reads: key -> (which law, which of the package's own does)
READ_BY = {
    "normal_force": ("normal", "prescribed"),
    "initial_gap": ("normal", "unilateral"),
    "friction": ("tangential", "coulomb"),
    "static_friction": ("tangential", "coulomb"),
}


class Contact(Section):
    """The joint between two bodies and its laws."""

    body_a: str = entry("blade", "-", "Body A: normals point out of it, and friction forces are those on it.")
    body_b: str = entry("disk", "-", "Body B, on which it rests.")
    flanks: tuple[str, ...] | None = entry(
        None,
        "-",
        "Boundaries in contact; by default all that both bodies share, but of those held, loaded or followed only "
        "where the bodies lie face to face.",
        min_length=1,
    )
    law_files: tuple[Path, ...] = entry(
        (), "-", "Python files that register laws of your own (`docs/adding_a_law.md`); relative to the scene file."
    )
    normal: Normal = entry(
        "unilateral",
        "-",
        "Normal law: `unilateral` (contact that opens), `bonded`, `prescribed` (a given normal force), or your own.",
    )
    tangential: Tangential = entry(
        "coulomb", "-", "Tangential law: `coulomb`, `frictionless`, `bonded`, or one of your own."
    )
    parameters: Parameters = Field({}, description="Parameters of laws of your own, by name.")
    friction: Number = entry(0.2, "-", "Coefficient of friction, for the law `coulomb`.", ge=0, le=1e6)
    static_friction: StaticFriction = entry(
        "resolved",
        "-",
        "Mean friction where a pair sticks throughout: `resolved`, the least; `held`, as loaded slowly from rest. "
        "`zero`: none at any pair, as in the paper.",
    )
    initial_gap: Number = entry(0.0, "m", "Initial clearance of every pair; negative: interference, as of a press fit.")
    normal_force: Number | None = entry(
        None,
        "N",
        "Normal force of every pair, for the law `prescribed`: it acts on both bodies, away from each other, and what "
        "presses them together is stated as loads.",
        ge=0,
    )
    pair_tolerance: Number = entry(
        1e-6,
        "-",
        "Largest distance of two paired nodes, relative to the flank's length. They count as touching all the same.",
        gt=0,
    )

    @field_validator("law_files")
    @classmethod
    def register_laws(cls, files: tuple[Path, ...], info: ValidationInfo) -> tuple[Path, ...]:
        """First of the entries on laws, so that the names of these laws are known to the next ones."""
        files = tuple(((info.context or {}).get("folder", Path()) / file).resolve() for file in files)
        for file in files:
            try:
                load_laws(file)
            except KeyboardInterrupt:
                raise
            except BaseException as error:  # whatever the user's file does
                what = {"file": file.name, "error": tell_mistake(file, error)}
                raise PydanticCustomError("law_files", "{file} cannot be run: {error}", what) from error
        return files

    @model_validator(mode="after")
    def check_bodies(self) -> Contact:
        if self.body_a == self.body_b:
            raise PydanticCustomError("bodies", "body_a and body_b should differ; a body has no contact with itself")
        return self

    @property
    def can_wear(self) -> bool:
        """Whether the bodies press, part and slide, with friction or without: what wear needs and changes."""
        slides = "slip" in find_kind("tangential", self.tangential).histories
        return find_kind("normal", self.normal).opens and slides

    @property
    def acts_by_itself(self) -> bool:
        """Whether the joint moves the bodies without a load; a law of one's own may."""
        return is_own(find_kind("normal", self.normal)) or self.is_preloaded

    @property
    def is_preloaded(self) -> bool:
        """Whether an interference or a given normal force presses bodies together without a load."""
        return self.initial_gap < 0 or bool(self.normal == "prescribed" and self.normal_force)


class Flank(Section):
    """Laws of one flank where they differ from those in `[contact]`."""

    normal: Normal | None = entry(None, "-", "Normal law of this flank.")
    tangential: Tangential | None = entry(None, "-", "Tangential law of this flank.")
    parameters: Parameters | None = entry(None, "-", "Parameters of laws of your own on this flank.")
    friction: Number | None = entry(None, "-", "Coefficient of friction of this flank.", ge=0, le=1e6)
    static_friction: StaticFriction | None = entry(None, "-", "Mean friction force of this flank.")
    initial_gap: Number | None = entry(None, "m", "Initial clearance of this flank's pairs; negative: interference.")
    normal_force: Number | None = entry(None, "N", "Normal force of each of this flank's pairs.", ge=0)
    wear: Number | None = entry(
        None, "1/Pa", "Wear coefficient of this flank in place of `[wear]`'s; 0: no wear.", ge=0
    )

    @property
    def laws(self) -> dict[str, Any]:
        """The entries on laws that were given."""
        return {key: value for key, value in self if value is not None and key != "wear"}
