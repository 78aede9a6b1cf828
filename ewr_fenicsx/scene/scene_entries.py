"""What the tables of a scene are made of: entries with units, strict numbers, tables that refuse unknown keys."""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from operator import or_
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Discriminator, Field, FiniteFloat, Strict, Tag, model_validator
from pydantic_core import PydanticCustomError

from ewr_fenicsx.errors import nearest

Number = Annotated[FiniteFloat, Strict()]  # strict: "0.2" and true are mistakes, not numbers
Integer = Annotated[int, Strict()]
Positive = Annotated[Number, Field(gt=0)]
Ratio = Annotated[Number, Field(ge=0, lt=1)]
Vector = Annotated[tuple[Number, ...], Field(min_length=2, max_length=3)]  # (x, y), of solids (x, y, z)


def entry(default: Any, unit: str, description: str, **limits: Any) -> Any:
    """A field with a unit; ``...`` as default makes it required."""
    return Field(default, description=description, json_schema_extra={"unit": unit}, validate_default=True, **limits)


def section(kind: Any, description: str) -> Any:
    """A field that holds a table of its own, with that table's defaults."""
    return Field(default_factory=kind, description=description)


class Section(BaseModel):
    """A table of the scene: frozen, and unknown keys are errors that name the nearest known one."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)
    forms: ClassVar[Mapping[str, type[Section]]] = {}  # by their ``kind``, of a table that has several

    @model_validator(mode="before")
    @classmethod
    def refuse_unknown_keys(cls, data: Any) -> Any:
        if isinstance(data, Mapping):
            known = [field.alias or name for name, field in cls.model_fields.items()]
            for key in data:
                if key not in known and key not in cls.model_fields:
                    others = [kind for kind, form in cls.forms.items() if key in form.model_fields]
                    hint = f'; it belongs to kind = "{others[0]}"' if others else nearest(key, known)
                    hint = hint or "; known keys: " + ", ".join(known)
                    raise PydanticCustomError("unknown_key", "unknown key{hint}", {"key": str(key), "hint": hint})
        return data


def choose_form(*forms: tuple[str, type[Section]]) -> Any:
    """Alternative forms of a table, told apart by its key ``kind``; the first is meant where ``kind`` is left out."""
    usual = forms[0][0]
    for _, form in forms:
        form.forms = dict(forms)
    # the tags must not look like keys: pydantic mixes them into the path of an error
    tag = lambda data: f"kind={data.get('kind', usual) if isinstance(data, Mapping) else getattr(data, 'kind', usual)}"  # noqa: E731
    known = " or ".join(f'"{kind}"' for kind, _ in forms)
    tagged = tuple(Annotated[form, Tag(f"kind={kind}")] for kind, form in forms)
    discriminator = Discriminator(tag, custom_error_type="kind", custom_error_message=f"should be {known}")
    return Annotated[reduce(or_, tagged), discriminator]
