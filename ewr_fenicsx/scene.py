"""What a user asks for: one frozen, validated description of a joint, its loads and its solve.

A scene comes from a TOML file (``load_scene``) or from Python (``Scene(...)``, same names). Its units are those that
people type: m, Pa, N, Hz, rpm, degrees. Every field carries its unit and meaning; ``scene_reference.py`` prints them.
Nothing here imports dolfinx: a wrong scene is refused within a moment.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    FiniteFloat,
    PrivateAttr,
    Strict,
    Tag,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from ewr_fenicsx.errors import SceneError, nearest
from ewr_fenicsx.scene_errors import explain_mistakes, name_scene

Number = Annotated[FiniteFloat, Strict()]  # strict: "0.2" and true are mistakes, not numbers
Integer = Annotated[int, Strict()]
Positive = Annotated[Number, Field(gt=0)]
Ratio = Annotated[Number, Field(ge=0, lt=1)]
Vector = tuple[Number, Number]


def entry(default: Any, unit: str, description: str, **limits: Any) -> Any:
    """A field with a unit; ``...`` as default makes it required."""
    return Field(default, description=description, json_schema_extra={"unit": unit}, validate_default=True, **limits)


def section(kind: Any, description: str) -> Any:
    """A field that holds a table of its own, with that table's defaults."""
    return Field(default_factory=kind, description=description)


class Section(BaseModel):
    """A table of the scene: frozen, and unknown keys are errors that name the nearest known one."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def refuse_unknown_keys(cls, data: Any) -> Any:
        if isinstance(data, Mapping):
            for key in data:
                if key not in cls.model_fields:
                    hint = nearest(key, cls.model_fields) or "; known keys: " + ", ".join(cls.model_fields)
                    raise PydanticCustomError("unknown_key", "unknown key{hint}", {"key": str(key), "hint": hint})
        return data


class Geometry(Section):
    """Where the mesh comes from."""

    source: Path = entry(
        ..., "-", "Builder (.py with a `build` function) or gmsh mesh (.msh); relative to the scene file."
    )
    parameters: dict[str, Any] = Field({}, description="Keyword arguments of the builder's `build`; lengths in m.")

    @field_validator("source")
    @classmethod
    def find_source(cls, source: Path, info: ValidationInfo) -> Path:
        source = ((info.context or {}).get("folder", Path()) / source).resolve()
        if source.suffix not in (".py", ".msh"):
            raise PydanticCustomError("source", "should be a builder (.py) or a gmsh mesh (.msh)")
        if not source.is_file():
            raise PydanticCustomError("source", "no such file: {path}", {"path": str(source)})
        return source

    @model_validator(mode="after")
    def refuse_parameters_of_a_mesh_file(self) -> Geometry:
        if self.source.suffix == ".msh" and self.parameters:
            raise PydanticCustomError("parameters", "parameters are for builders (.py); a .msh file takes none")
        return self


class Material(Section):
    """Linear elastic, isotropic. The default is Ti-6Al-4V."""

    young: Number = entry(113.8e9, "Pa", "Young's modulus.", gt=0)
    poisson: Number = entry(0.342, "-", "Poisson's ratio.", gt=-1, lt=0.5)
    density: Number = entry(4430.0, "kg/m^3", "Mass density.", gt=0)


class Elasticity(Section):
    """The finite-element model of the bodies."""

    plane: Literal["stress", "strain"] = entry("stress", "-", "Plane stress or plane strain.")
    thickness: Number = entry(0.01, "m", "Thickness across the plane.", gt=0)
    degree: Literal[1, 2] = entry(1, "-", "Polynomial degree of the elements.")


class RayleighDamping(Section):
    """D = alpha M + beta K."""

    kind: Literal["rayleigh"] = entry(..., "-", "Which form of damping this is.")
    alpha: Number = entry(..., "1/s", "Factor of the mass matrix.", ge=0)
    beta: Number = entry(..., "s", "Factor of the stiffness matrix.", ge=0)


class RatioDamping(Section):
    """D = alpha M + beta K with the given ratios of critical damping at two frequencies."""

    kind: Literal["ratios"] = entry("ratios", "-", "Which form of damping this is.")
    ratios: tuple[Ratio, Ratio] = entry((0.002, 0.002), "-", "Ratios of critical damping at the two frequencies.")
    frequencies: tuple[Positive, Positive] = entry((500.0, 3000.0), "Hz", "The two frequencies, rising.")

    @model_validator(mode="after")
    def check_order(self) -> RatioDamping:
        if self.frequencies[0] >= self.frequencies[1]:
            raise PydanticCustomError("order", "the two frequencies should rise, and differ")
        return self


class ModalDamping(Section):
    """The same ratio of critical damping for every mode of the reduced basis."""

    kind: Literal["modal"] = entry(..., "-", "Which form of damping this is.")
    ratio: Number = entry(..., "-", "Ratio of critical damping of every mode.", ge=0, lt=1)


class Supports(Section):
    """Where bodies are held."""

    clamp: tuple[str, ...] = entry(("clamp",), "-", "Boundaries held in all directions.")


class ForceLoad(Section):
    """A force spread evenly over a boundary, `force * cos(harmonic * omega t + phase)`."""

    kind: Literal["force"] = entry("force", "-", "Which kind of load this is.")
    boundary: str = entry(..., "-", "Boundary that carries the force.")
    force: Vector = entry(..., "N", "Resultant (x, y).")
    harmonic: Integer = entry(0, "-", "0 is static, 1 follows the excitation frequency, 2 is twice that.", ge=0)
    phase: Number = entry(0.0, "degree", "Phase at time zero.")

    @model_validator(mode="after")
    def check_load(self) -> ForceLoad:
        if not any(self.force):
            raise PydanticCustomError("force", "the force is zero; remove this load or give it a value")
        if self.harmonic == 0 and self.phase:
            raise PydanticCustomError("phase", "a static load (harmonic = 0) has no phase; was harmonic = 1 meant?")
        return self


class RotationLoad(Section):
    """The centrifugal body force of a rotation about an axis normal to the plane; static."""

    kind: Literal["rotation"] = entry(..., "-", "Which kind of load this is.")
    speed: Number = entry(..., "rpm", "Speed of rotation.", gt=0)
    centre: Vector = entry((0.0, 0.0), "m", "Where the axis meets the plane (x, y).")

    @property
    def harmonic(self) -> int:
        return 0


def _choice(*forms: tuple[str, type[Section]]) -> Any:
    """Alternative forms of a table, told apart by its key ``kind``; the first is meant where ``kind`` is left out."""
    usual = forms[0][0]
    # the tags must not look like keys: pydantic mixes them into the path of an error
    tag = lambda data: f"kind={data.get('kind', usual) if isinstance(data, Mapping) else getattr(data, 'kind', usual)}"  # noqa: E731
    known = " or ".join(f'"{kind}"' for kind, _ in forms)
    tagged = tuple(Annotated[form, Tag(f"kind={kind}")] for kind, form in forms)
    discriminator = Discriminator(tag, custom_error_type="kind", custom_error_message=f"should be {known}")
    return Annotated[reduce(or_, tagged), discriminator]


Damping = _choice(("ratios", RatioDamping), ("rayleigh", RayleighDamping), ("modal", ModalDamping))
Load = _choice(("force", ForceLoad), ("rotation", RotationLoad))


class Output(Section):
    """A displacement to follow: the mean over a boundary along a direction."""

    boundary: str = entry(..., "-", "Boundary whose mean displacement is followed.")
    direction: Vector = entry(..., "-", "Direction (x, y); its length does not matter.")

    @field_validator("direction")
    @classmethod
    def check_direction(cls, direction: Vector) -> Vector:
        if not any(direction):
            raise PydanticCustomError("direction", "should not be the zero vector")
        return direction


class Contact(Section):
    """The joint between two bodies and its laws."""

    body_a: str = entry("blade", "-", "The body whose outward normal counts.")
    body_b: str = entry("disk", "-", "The body it rests on.")
    flanks: tuple[str, ...] | None = entry(None, "-", "Boundaries in contact; by default all that both bodies share.")
    normal: Literal["unilateral", "bonded", "prescribed"] = entry(
        "unilateral", "-", "Normal law: contact with separation, no relative motion, or a given normal force."
    )
    tangential: Literal["coulomb", "frictionless", "bonded"] = entry("coulomb", "-", "Tangential law.")
    friction: Number = entry(0.2, "-", "Coefficient of friction, for the law `coulomb`.", ge=0)
    static_friction: Literal["resolved", "zero"] = entry(
        "resolved", "-", "Mean friction force: solved for, or set to zero as in the paper."
    )
    initial_gap: Number = entry(0.0, "m", "Initial clearance of every pair.", ge=0)
    normal_force: Number | None = entry(None, "N", "Normal force of every pair, for the law `prescribed`.", ge=0)
    pair_tolerance: Number = entry(
        1e-6, "-", "Largest distance of two paired nodes, relative to the flank's length.", gt=0
    )

    @model_validator(mode="after")
    def check_laws(self) -> Contact:
        if self.body_a == self.body_b:
            raise PydanticCustomError("bodies", "body_a and body_b should differ; a body has no contact with itself")
        if self.normal == "prescribed" and self.normal_force is None:
            raise PydanticCustomError("laws", 'normal = "prescribed" needs normal_force [N], the force of every pair')
        for key, law, value in (
            ("normal_force", "normal", "prescribed"),
            ("initial_gap", "normal", "unilateral"),
            ("friction", "tangential", "coulomb"),
            ("static_friction", "tangential", "coulomb"),
        ):
            if key in self.model_fields_set and getattr(self, key) is not None and getattr(self, law) != value:
                context = {"key": key, "law": law, "found": getattr(self, law), "value": value}
                raise PydanticCustomError(
                    "laws", '{key} does nothing with {law} = "{found}"; remove it, or set {law} = "{value}"', context
                )
        return self


class Reduction(Section):
    """Component mode synthesis."""

    modes: Integer = entry(30, "-", "Fixed-interface modes kept.", ge=1)


class Excitation(Section):
    """What repeats."""

    frequency: Number = entry(..., "Hz", "Frequency of harmonic 1.", gt=0)


class Solver(Section):
    """Harmonic balance and its nonlinear solve."""

    harmonics: Integer | tuple[Integer, ...] = entry(
        5, "-", "Highest harmonic N (0 to N are used), or a list of harmonics."
    )
    samples: Integer | None = entry(None, "-", "Time samples a period; by default enough for the harmonics.", ge=3)
    rho_normal: Number | None = entry(
        None, "N/m", "Normal parameter of the equality form; by default from the compliance.", gt=0
    )
    rho_tangential: Number | None = entry(
        None, "m/(N s)", "Tangential parameter; by default from the compliance.", gt=0
    )
    tolerance: Number = entry(1e-8, "-", "Relative residual at which the solve ends.", gt=0, lt=1)

    @field_validator("harmonics")
    @classmethod
    def check_harmonics(cls, harmonics: int | tuple[int, ...]) -> int | tuple[int, ...]:
        if isinstance(harmonics, int):
            if harmonics < 0:
                raise PydanticCustomError("harmonics", "should not be negative")
        elif not harmonics or min(harmonics) < 0 or len(set(harmonics)) != len(harmonics):
            raise PydanticCustomError("harmonics", "should be distinct and not negative, e.g. [0, 1, 3]")
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
    loads: dict[str, Load] = Field(min_length=1, description="Loads by name.")
    outputs: dict[str, Output] = Field({}, description="Displacements to follow, by name.")
    contact: Contact = section(Contact, "The joint and its laws.")
    reduction: Reduction = section(Reduction, "Component mode synthesis.")
    excitation: Excitation = Field(description="What repeats.")
    solver: Solver = section(Solver, "Harmonic balance and its nonlinear solve.")
    _file: Path | None = PrivateAttr(None)

    @property
    def harmonics(self) -> tuple[int, ...]:
        """Harmonics of the solution, rising."""
        chosen = self.solver.harmonics
        return tuple(range(chosen + 1)) if isinstance(chosen, int) else tuple(sorted(chosen))

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
        for name, load in scene.loads.items():
            if load.harmonic not in scene.harmonics:
                raise SceneError(
                    f"{name_scene(file)}: solver.harmonics = {list(scene.harmonics)} leave out harmonic "
                    f'{load.harmonic}, at which the load "{name}" acts; include it'
                )
        scene._file = file
        return scene


def load_scene(path: str | Path) -> Scene:
    """Reads and checks a scene file.

    Args:
        path: TOML file. Paths inside it are relative to its folder.

    Raises:
        SceneError: The file cannot be read, is not TOML, or does not describe a scene.
    """
    path = Path(path)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SceneError(f"scene {path}: cannot be read: {error.strerror}; give the path of a .toml file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"scene {path}: not valid TOML: {error}") from None
    return Scene.model_validate(data, context={"file": path, "folder": path.resolve().parent})
