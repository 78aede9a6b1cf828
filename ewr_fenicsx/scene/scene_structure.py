"""The structure of a scene: geometry, materials, supports, loads and outputs; all but the joint, and what is solved."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator
from pydantic_core import PydanticCustomError

from ewr_fenicsx.model.cyclic_symmetry import MOST_SECTORS, MOST_WAVES
from ewr_fenicsx.scene.scene_entries import Integer, Number, Positive, Ratio, Section, Vector, choose_form, entry

HIGHEST_HARMONIC = 255  # beyond it a solve would take more memory than there is
LOCKING = 0.48  # Poisson's ratio from which elements of first order are too stiff by a tenth to a half, in frequency


def _refuse_zero(direction: tuple[float, ...]) -> tuple[float, ...]:
    if not any(direction):
        raise PydanticCustomError("direction", "should not be the zero vector")
    return direction


Direction = Annotated[Vector, AfterValidator(_refuse_zero)]
Axis = Annotated[tuple[Number, Number, Number], AfterValidator(_refuse_zero)]


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
            raise PydanticCustomError("source", "should be a builder (.py) or a gmsh mesh (.msh), as gmsh -2 makes it")
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


def doubt_materials(stated: Mapping[str, Material], bodies: Iterable[str], locks: bool) -> Iterator[str]:
    """What was probably not meant, one sentence each: half a material, none beside others, one in elements that lock.

    Args:
        stated: Materials by body.
        bodies: All that there are.
        locks: As ``Elasticity.locks``.
    """
    for body, material in stated.items():
        if locks and material.poisson >= LOCKING:
            yield (
                f"materials.{body}.poisson = {material.poisson:g} with elasticity.degree = 1: elements of first order "
                "are far too stiff where a material hardly changes its volume; take elasticity.degree = 2"
            )
        for key, other in (("young", "density"), ("density", "young")):
            if key not in material.model_fields_set and other in material.model_fields_set:
                yield (
                    f"materials.{body}.{key}: missing beside {other} = {getattr(material, other):g}, so that it is "
                    f"{getattr(material, key):g}, that of Ti-6Al-4V; give it as well"
                )
    if stated and (others := [body for body in bodies if body not in stated]):
        yield (
            f"materials: {', '.join(stated)} {'has' if len(stated) == 1 else 'have'} one, {', '.join(others)} "
            f"{'has' if len(others) == 1 else 'have'} none and will be of Ti-6Al-4V, the default; give each body its "
            "[materials.BODY], which may be empty"
        )


class Elasticity(Section):
    """The finite-element model of the bodies."""

    plane: Literal["stress", "strain"] = entry("stress", "-", "Plane stress or plane strain; solids are neither.")
    thickness: Number = entry(0.01, "m", "Thickness across the plane; solids have none.", gt=0)
    degree: Literal[1, 2] = entry(1, "-", "Polynomial degree of the elements.")

    @field_validator("degree", mode="before")
    @classmethod
    def check_degree(cls, degree: Any) -> Any:
        if type(degree) is not int or degree not in (1, 2):  # of Python's true and 1.0 either is 1 as well
            raise PydanticCustomError("degree", "should be 1 or 2")
        return degree

    def locks(self, dimension: int) -> bool:
        """Whether elements resist nearly incompressible bending; in plane stress the thickness gives way."""
        return self.degree == 1 and (dimension == 3 or self.plane == "strain")


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
    """The same ratio of critical damping for every mode of the open joint.

    Where the joint holds a body that would otherwise float, the lowest modes of the stuck joint have this ratio too;
    its other modes have somewhat less. `ewr info` tells the ratio of the first stuck mode. What that takes also drags
    such a body where it slides far or lifts off, and gives the lowest modes of the open joint up to half as much again:
    take `rayleigh` with `alpha = 0` there.
    """

    kind: Literal["modal"] = entry(..., "-", "Which form of damping this is.")
    ratio: Number = entry(..., "-", "Ratio of critical damping of every mode of the open joint.", ge=0, lt=1)


Axes = Literal["x", "y", "z", "xy", "xz", "yz"]


class Supports(Section):
    """Where bodies are held.

    A boundary that is held across itself alone is a plane of symmetry: of a joint that is symmetric to it, with loads
    that are, half need be meshed, under half of the forces.
    """

    clamp: tuple[str, ...] = entry(("clamp",), "-", "Boundaries held in all directions.")
    hold: dict[str, Axes] = entry(
        {},
        "-",
        'Boundary = axes along which it is held, one or two of x, y and z, as `{ front = "z" }`: a plane of symmetry, '
        "or what keeps a blade from sliding along its slot.",
    )

    @property
    def boundaries(self) -> tuple[str, ...]:
        """All that are held, in whatever direction."""
        return (*self.clamp, *self.hold)


class Cyclic(Section):
    """The mesh is one of many equal sectors that form a ring, such as a bladed disk; the loads travel round it.

    Each sector moves as the one before it did `engine_order / sectors` of a period ago: one of them is solved for all,
    at its own cost. Static loads act on every sector alike. Sectors follow one another about `axis` in the sense of a
    right hand, counter-clockwise in a plane.
    """

    sectors: Integer = entry(..., "-", "Number of sectors in the ring.", ge=2, le=MOST_SECTORS)
    engine_order: int = entry(
        ...,
        "-",
        "Waves of the load round the ring: harmonic 1 acts on the next sector `engine_order / sectors` of a period "
        "later. Negative: it travels the other way; 0: all sectors are in phase.",
        strict=True,
        ge=-MOST_WAVES,
        le=MOST_WAVES,
    )
    low: str | None = entry(
        None, "-", "Boundary where the sector is cut from the one before; none where only `flanks` join the sectors."
    )
    high: str | None = entry(
        None, "-", "Boundary where it is cut from the next one: `low` turned by `360 / sectors` degrees, node by node."
    )
    flanks: dict[str, tuple[str, str]] = entry(
        {},
        "-",
        "Name = boundary on which the next sector lies, and which of its boundaries that is, as "
        '`{ shroud = ["right_face", "left_face"] }`: contact between sectors, with the laws of `[contact]` or of '
        "`[flanks.NAME]`.",
    )
    centre: Vector = entry(
        (0.0, 0.0), "m", "Where the axis meets the plane (x, y), of solids any point of it (x, y, z)."
    )
    axis: Axis = entry((0.0, 0.0, 1.0), "-", "Direction of the axis; its length does not matter.")

    @model_validator(mode="after")
    def check_cuts(self) -> Cyclic:
        if (self.low is None) != (self.high is None):
            raise PydanticCustomError("cuts", "a sector has two cuts: give low and high, or neither")
        if self.low is None and not self.flanks:
            raise PydanticCustomError("cuts", "nothing joins the sectors: give low and high, or flanks, or both")
        if self.low and self.low == self.high:
            raise PydanticCustomError(
                "cuts", 'low and high are both "{name}"; a sector has two cuts', {"name": self.low}
            )
        for name, both in self.flanks.items():
            if len({*both, *self.cuts}) < len(both) + len(self.cuts):
                what = {"name": name, "both": " and ".join(both)}
                raise PydanticCustomError("flanks", "{name} is on {both}: give two boundaries that are no cuts", what)
        return self

    @property
    def cuts(self) -> tuple[str, ...]:
        """Both cuts, or none."""
        return (self.low, self.high) if self.low and self.high else ()

    @property
    def boundaries(self) -> dict[str, str]:
        """Key of each boundary that is named, and its name."""
        named = {"low": self.low, "high": self.high} if self.cuts else {}
        return named | {f"flanks.{name}[{k}]": both[k] for name, both in self.flanks.items() for k in (0, 1)}


class ForceLoad(Section):
    """A force spread evenly over a boundary, `force * cos(harmonic * omega t + phase)`."""

    kind: Literal["force"] = entry("force", "-", "Which kind of load this is.")
    boundary: str = entry(..., "-", "Boundary that carries the force.")
    force: Vector = entry(..., "N", "Resultant (x, y), of solids (x, y, z).")
    harmonic: Integer = entry(
        0, "-", "0 is static, 1 follows the excitation frequency, 2 is twice that.", ge=0, le=HIGHEST_HARMONIC
    )
    phase: Number = entry(0.0, "degree", "Phase at time zero.")

    @model_validator(mode="after")
    def check_load(self) -> ForceLoad:
        if not any(self.force):
            raise PydanticCustomError("force", "the force is zero; remove this load or give it a value")
        if self.harmonic == 0 and self.phase:
            raise PydanticCustomError("phase", "a static load (harmonic = 0) has no phase; was harmonic = 1 meant?")
        return self


class RotationLoad(Section):
    """The centrifugal body force of a rotation about an axis, in a plane normal to it; static.

    It loads the bodies and nothing else: that tension stiffens them, and rotation softens them, is left out. A slender
    blade at high speed has higher frequencies than are found here.
    """

    kind: Literal["rotation"] = entry(..., "-", "Which kind of load this is.")
    speed: Number = entry(..., "rpm", "Speed of rotation.", gt=0, le=1e9)
    centre: Vector = entry(
        ...,
        "m",
        "Where the axis meets the plane (x, y), of solids any point of it (x, y, z), in the mesh's coordinates.",
    )
    axis: Axis = entry((0.0, 0.0, 1.0), "-", "Direction of the axis; its length does not matter.")

    @property
    def harmonic(self) -> int:
        return 0


Damping = choose_form(("ratios", RatioDamping), ("rayleigh", RayleighDamping), ("modal", ModalDamping))
Load = choose_form(("force", ForceLoad), ("rotation", RotationLoad))


class Output(Section):
    """A displacement to follow: the mean over a boundary along a direction."""

    boundary: str = entry(..., "-", "Boundary whose mean displacement is followed.")
    direction: Direction = entry(..., "-", "Direction (x, y), of solids (x, y, z); its length does not matter.")


class Reduction(Section):
    """Component mode synthesis."""

    modes: Integer = entry(
        30, "-", "Fixed-interface modes kept; with an accuracy only to begin with: more are added as needed.", ge=1
    )
