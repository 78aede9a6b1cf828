"""What a user asks for: one frozen, validated description of a joint, its loads and its solve.

A scene comes from a TOML file (``load_scene``) or from Python (``Scene(...)``, same names). Its units are those that
people type: m, Pa, N, Hz, rpm, degrees. Every field carries its unit and meaning; ``scene_reference.py`` prints them.
Nothing here imports dolfinx: a wrong scene is refused within a moment.
"""

from __future__ import annotations

import math
import tomllib
import warnings
from collections.abc import Mapping
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    Discriminator,
    Field,
    PrivateAttr,
    Tag,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from ewr_fenicsx.errors import SceneError, SceneWarning
from ewr_fenicsx.scene.scene_entries import Integer, Number, Positive, Section, entry, section
from ewr_fenicsx.scene.scene_errors import explain_mistakes, explain_syntax, list_mistakes, name_scene
from ewr_fenicsx.scene.scene_joint import Contact, Flank
from ewr_fenicsx.scene.scene_sense import find_contradictions, find_doubts
from ewr_fenicsx.scene.scene_structure import (
    HIGHEST_HARMONIC,
    Cyclic,
    Damping,
    Elasticity,
    Geometry,
    Load,
    Material,
    Output,
    RatioDamping,
    Reduction,
    Supports,
)

MOST_SAMPLES = 65536  # beyond it a solve would take more memory than there is
MOST_POINTS = 100_000  # of a sweep; beyond it the list alone would be long to make, and the solves take weeks


class FrequencyRange(Section):
    """Frequencies at equal distances, both ends included."""

    from_: Positive = entry(..., "Hz", "Where the sweep begins.", alias="from")
    to: Positive = entry(..., "Hz", "Where it ends.")
    points: Integer = entry(..., "-", "Number of frequencies.", ge=2, le=MOST_POINTS)

    @model_validator(mode="after")
    def check_extent(self) -> FrequencyRange:
        if self.from_ == self.to:
            raise PydanticCustomError(
                "range", "a sweep over one point; write frequency = {at}", {"at": format(self.from_, "g")}
            )
        if self.from_ > self.to:
            raise PydanticCustomError("range", "from should be below to; curves are followed past folds either way")
        return self


@lru_cache(maxsize=16)  # a scene asks for its frequencies many times
def _spread(begin: float, end: float, points: int) -> tuple[float, ...]:
    step = (end - begin) / (points - 1)
    return (*(begin + k * step for k in range(points - 1)), end)


def _tell_frequency_form(asked: Any) -> str:
    if isinstance(asked, (Mapping, FrequencyRange)):
        return "kind=range"
    if asked is None:
        return "kind=none"
    return "kind=list" if isinstance(asked, (list, tuple)) else "kind=number"


# Told apart by what they look like, so that a mistake in one is not told in the words of the others
Frequency = Annotated[
    Annotated[Positive, Tag("kind=number")]
    | Annotated[tuple[Positive, ...], Tag("kind=list")]
    | Annotated[FrequencyRange, Tag("kind=range")]
    | Annotated[None, Tag("kind=none")],
    Discriminator(_tell_frequency_form),
]


class Excitation(Section):
    """The period of the motion. Required unless no load oscillates."""

    frequency: Frequency = entry(
        None, "Hz", "Frequency of harmonic 1; a list, or a table `from`, `to`, `points`, is a sweep."
    )

    @field_validator("frequency", mode="before")
    @classmethod
    def check_number(cls, frequency: Any) -> Any:
        if _tell_frequency_form(frequency) != "kind=number":
            return frequency
        if isinstance(frequency, bool) or not isinstance(frequency, (int, float)) or not 0 < frequency < math.inf:
            raise PydanticCustomError(
                "frequency",
                "should be a positive number, a list of them, or a table with from, to and points; leave it out where "
                "nothing oscillates",
            )
        return frequency

    @field_validator("frequency")
    @classmethod
    def check_frequency(cls, frequency: Any) -> Any:
        if isinstance(frequency, tuple):
            if not frequency:
                raise PydanticCustomError("sweep", "a sweep over no point; give frequencies that rise, or a single one")
            if len(frequency) == 1:
                at = f"{frequency[0]:g}"
                raise PydanticCustomError("sweep", "a sweep over one point; write frequency = {at}", {"at": at})
            if any(a >= b for a, b in pairwise(frequency)):
                raise PydanticCustomError("sweep", "should be frequencies that rise")
        return frequency


class Wear(Section):
    """Fretting wear over many cycles (Archard): the gap grows by `coefficient` x pressure x sliding distance."""

    coefficient: Number = entry(
        1e-11,
        "1/Pa",
        "Wear coefficient of every flank that opens and slides, with friction or without. The default is that of the "
        "paper's studies; give what was measured for your surfaces.",
        ge=0,
    )
    cycles: Integer = entry(3000, "-", "Cycles of the excitation to follow.", ge=1, le=10**12)
    tolerance: Number | None = entry(
        None,
        "-",
        "Largest error that jumps over cycles may cause, as a share of the final depth; by default the solver's "
        "accuracy, and without one every cycle is solved.",
        gt=0,
        lt=1,
    )


class Solver(Section):
    """Harmonic balance and its nonlinear solve."""

    accuracy: Number | None = entry(
        None,
        "-",
        "Largest relative error of the outputs' oscillation, at every frequency of a sweep, and of the wear rate; the "
        "solver then chooses harmonics, samples and modes, and weights and closure unless they are given. The error of "
        "the mesh is not in it.",
        gt=0,
        lt=1,
    )
    harmonics: Integer | tuple[Integer, ...] = entry(
        5, "-", "Highest harmonic N (0 to N are used), or a list of harmonics; contact that opens needs 0."
    )
    samples: Integer | None = entry(
        None,
        "-",
        "Time samples a period; by default 32 a highest harmonic or more, at least 128.",
        ge=3,
        le=MOST_SAMPLES,
    )
    rho_normal: Number | None = entry(
        None, "N/m", "Weight rho_N of the normal law (`docs/method.md`); by default from the compliance.", gt=0
    )
    rho_tangential: Number | None = entry(
        None, "m/(N s)", "Weight rho_T of the friction law (`docs/method.md`); by default from the compliance.", gt=0
    )
    closure: Literal["mass", "dashpot", "spring"] = entry(
        "mass", "-", "What stands for the harmonics left out in Coulomb's law (`docs/method.md`)."
    )
    tolerance: Number = entry(1e-8, "-", "Relative residual at which the solve ends.", ge=1e-13, le=1e-3)

    @field_validator("harmonics")
    @classmethod
    def check_harmonics(cls, harmonics: int | tuple[int, ...]) -> int | tuple[int, ...]:
        if isinstance(harmonics, int):
            if harmonics < 0:
                raise PydanticCustomError("harmonics", "should not be negative")
        elif not harmonics or min(harmonics) < 0 or len(set(harmonics)) != len(harmonics):
            raise PydanticCustomError("harmonics", "should be distinct and not negative, e.g. [0, 1, 3]")
        highest = harmonics if isinstance(harmonics, int) else max(harmonics)
        if highest > HIGHEST_HARMONIC:
            raise PydanticCustomError(
                "harmonics", "should go up to {most} at most; 5 to 30 are usual", {"most": HIGHEST_HARMONIC}
            )
        return harmonics


class Scene(Section):
    """All of it: geometry, materials, joint, loads and solve.

    Raises:
        SceneError: A key, a type, a value or a combination makes no sense; names the file (when there is one), the key,
            the value and what was expected.
    """

    title: str = entry("", "-", "One line on what this scene shows.")
    geometry: Geometry = Field(description="Where the mesh comes from.")
    elasticity: Elasticity = section(Elasticity, "The finite-element model of the bodies.")
    materials: dict[str, Material] = Field({}, description="Material by body; Ti-6Al-4V where a body is not named.")
    damping: Damping = section(RatioDamping, "Viscous damping of the structure.")
    supports: Supports = section(Supports, "Where bodies are held.")
    cyclic: Cyclic | None = Field(None, description="The ring of which the mesh is a sector; none where it is missing.")
    loads: dict[str, Load] = Field({}, description="Loads by name; none where an interference is all that acts.")
    outputs: dict[str, Output] = Field({}, description="Displacements to follow, by name.")
    contact: Contact = section(Contact, "The joint and its laws.")
    flanks: dict[str, Flank] = Field({}, description="Laws of single flanks where they differ, by name of the flank.")
    reduction: Reduction = section(Reduction, "Component mode synthesis.")
    excitation: Excitation = section(Excitation, "What repeats.")
    wear: Wear | None = Field(None, description="Fretting wear; none where this table is missing.")
    solver: Solver = section(Solver, "Harmonic balance and its nonlinear solve.")
    _file: Path | None = PrivateAttr(None)

    @property
    def harmonics(self) -> tuple[int, ...]:
        """Harmonics of the solution, rising."""
        chosen = self.solver.harmonics
        return tuple(range(chosen + 1)) if isinstance(chosen, int) else tuple(sorted(chosen))

    @property
    def frequencies(self) -> tuple[float, ...]:
        """Frequencies to solve at [Hz]: one, those of a sweep, or none where nothing oscillates."""
        asked = self.excitation.frequency
        if asked is None or isinstance(asked, tuple):
            return asked or ()
        if isinstance(asked, FrequencyRange):
            return _spread(asked.from_, asked.to, asked.points)
        return (asked,)

    @property
    def listed_flanks(self) -> tuple[str, ...] | None:
        """Flanks that are named, those between sectors included; None: the mesh tells which there are."""
        beyond = tuple(self.cyclic.flanks) if self.cyclic else ()
        return None if self.contact.flanks is None else (*self.contact.flanks, *beyond)

    def laws_on(self, flank: str) -> Contact:
        """The joint's entries as they hold on one flank."""
        own = self.flanks.get(flank)
        return self.contact if own is None else self.contact.model_copy(update=own.laws)

    @property
    def doubts(self) -> tuple[str, ...]:
        """What is allowed but probably not meant, one sentence each."""
        return tuple(find_doubts(self))

    @property
    def where(self) -> str:
        """How messages call this scene: by its file, where it has one."""
        return name_scene(self._file)

    @model_validator(mode="wrap")
    @classmethod
    def explain_errors(cls, data: Any, handler: Any, info: ValidationInfo) -> Scene:
        file = (info.context or {}).get("file")
        try:
            scene = handler(data)
        except ValidationError as error:
            raise SceneError(explain_mistakes(error, data, file, cls.model_fields)) from None
        if contradictions := list(find_contradictions(scene)):
            raise SceneError(list_mistakes(contradictions, file))
        scene._file = file
        return scene


def load_scene(path: str | Path, *, warn: bool = True) -> Scene:
    """Reads and checks a scene file.

    Args:
        path: TOML file. Paths inside it are relative to its folder.
        warn: Whether to issue a ``SceneWarning`` on what was probably not meant; ``Scene.doubts`` lists it either way.

    Raises:
        SceneError: The file cannot be read, is not TOML, or does not describe a scene.
    """
    path = Path(path)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise SceneError(f"scene {path}: cannot be read: {error.strerror}; give the path of a .toml file") from None
    except (ValueError, RecursionError) as error:  # among them TOMLDecodeError and UnicodeDecodeError
        if path.suffix == ".msh":
            raise SceneError(f"scene {path}: a mesh; name it in a scene (.toml), as geometry.source") from None
        raise SceneError(f"scene {path}: not valid TOML: {explain_syntax(error)}") from None
    scene = Scene.model_validate(data, context={"file": path, "folder": path.resolve().parent})
    for doubt in scene.doubts if warn else ():
        warnings.warn(f"{scene.where}: {doubt}", SceneWarning, stacklevel=2)
    return scene
