"""Whether a scene makes sense as a whole: what its entries, each of them right, would mean together.

A contradiction is an error, a doubt a warning. Each says what the scene would mean and what was probably meant.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ewr_fenicsx.errors import nearest
from ewr_fenicsx.laws.law_kinds import find_kind, list_parameters
from ewr_fenicsx.scene.scene_joint import READ_BY, Contact

if TYPE_CHECKING:
    Scene = Any  # scene.py comes later; it calls these

# Beyond these a value was probably given in another unit
SOFTEST = 1e7  # Young's modulus [Pa]
DENSITIES = (100.0, 25e3)  # [kg/m^3]
THICKEST, WIDEST, LONGEST = 1.0, 1e-3, 20.0  # thickness, initial gap, extent of the mesh [m]
FARTHEST = 100.0  # extents of the mesh that the centre of a rotation lies away
SOFTEST_SURFACE = 1e-9  # wear coefficient [1/Pa]
ROUGHEST = 3.0  # coefficient of friction
MOST_DAMPED = 0.1  # ratio of critical damping
DRAG = 0.1  # loss factor of rigid motions of bodies that only the joint holds
# A frequency between these shares of the first full-stick mode, and below so many Hz, was probably given in kHz:
# compact parts may be driven as far below their modes, at more Hz than that
KILOHERTZ, MOST_KILOHERTZ = (3e-4, 2e-3), 30.0
MILLIMETRES = (100.0, 1e4)  # and a builder's parameter in mm, over its default
MANY_CYCLES = 100_000  # of which every one is solved


def find_contradictions(scene: Scene) -> Iterator[str]:
    """What cannot be meant, one sentence each."""
    yield from _check_harmonics(scene)
    yield from _check_supports(scene)
    yield from _check_accuracy(scene)
    yield from _check_ring(scene)
    yield from _check_excitation(scene)
    yield from _check_laws(scene)
    yield from _check_wear(scene)


def find_doubts(scene: Scene) -> Iterator[str]:
    """What is allowed but probably not meant, one sentence each."""
    yield from _doubt_units(scene)
    joint = laws_in_force(scene)
    for where, laws in joint.items():
        if laws.tangential == "coulomb" and laws.friction == 0:
            yield (
                f"{where}.friction = 0: friction that never resists, at the cost of its unknowns; "
                'was tangential = "frictionless" meant?'
            )
    if scene.wear and scene.wear.cycles > MANY_CYCLES and scene.wear.tolerance is scene.solver.accuracy is None:
        yield (
            f"wear.cycles = {scene.wear.cycles}: every one of them is solved; give wear.tolerance (0.01: errors up to "
            "1 % of the final depth), and most are jumped over"
        )
    opening = [where for where, c in joint.items() if find_kind("normal", c.normal).opens and c.initial_gap == 0]
    if opening and not (static_loads(scene) or any(c.is_preloaded for c in joint.values())):
        yield (
            f'{opening[0]}.normal = "{joint[opening[0]].normal}", and no load is static: nothing presses the joint '
            "together, and it gapes or rattles; was a static load (harmonic = 0, or a rotation) forgotten?"
        )
    if not oscillating_loads(scene) and len(scene.frequencies) == 1:
        yield (
            f"excitation.frequency = {scene.frequencies[0]:g}: no load oscillates, so that it does nothing and the "
            "joint is solved at rest; was a load with harmonic = 1 forgotten?"
        )
    if len(scene.frequencies) > 1 and not scene.outputs:
        yield (
            "excitation.frequency is a sweep, and there are no outputs: the curve will hold figures of the contact "
            "alone; was an [outputs.NAME] forgotten?"
        )
    for key, law in (("rho_normal", "unilateral"), ("rho_tangential", "coulomb")):
        if getattr(scene.solver, key) is not None and not any(law in (c.normal, c.tangential) for c in joint.values()):
            yield f'solver.{key} = {getattr(scene.solver, key):g} does nothing: no flank has the law "{law}"; remove it'
    if scene.solver.closure == "spring" and not any(c.tangential == "coulomb" for c in joint.values()):
        yield 'solver.closure = "spring" does nothing: no flank has the law "coulomb"; remove it'


def doubt_lengths(scene: Scene, extent: float) -> Iterator[str]:
    """What is probably not meant by a mesh so long [m], or by lengths beside it, one sentence each."""
    if extent > LONGEST:
        yield f"geometry: the mesh is {extent:g} m long; lengths are in m: were mm meant?"
    size = scene.geometry.parameters.get("mesh_size")
    if isinstance(size, int | float) and size > extent:
        yield (
            f"geometry.parameters.mesh_size = {size:g} m is longer than the mesh, {extent:g} m; lengths are in m: were "
            "mm meant?"
        )
    for name, load in scene.loads.items():
        away = math.hypot(*getattr(load, "centre", ()))
        if away > FARTHEST * extent:
            yield (
                f"loads.{name}.centre = {list(load.centre)} lies {away:g} m from the origin of a mesh that is "
                f"{extent:g} m long; lengths are in m: were mm meant?"
            )


def doubt_simplices(dimension: int, nodes_a_cell: int) -> Iterator[str]:
    """What is probably not meant by cells of so many nodes, one sentence each."""
    simplices = {(2, 3): ("triangles", "quadrilaterals"), (3, 4): ("tetrahedra", "hexahedra")}
    if cells := simplices.get((dimension, nodes_a_cell)):
        yield (
            f"elasticity.degree = 1: {cells[0]} of first order are far too stiff in bending; take elasticity.degree = "
            f"2, or {cells[1]}"
        )


def doubt_closure(scene: Scene, dimension: int) -> Iterator[str]:
    """What is probably not meant by the closure of friction in a mesh of so many dimensions, one sentence each."""
    rubs = any(laws.tangential == "coulomb" for laws in laws_in_force(scene).values())
    if dimension == 3 and scene.solver.closure == "spring" and rubs:
        yield (
            'solver.closure = "spring" does nothing: the mesh is of solids, and dashpots alone close friction in a '
            "plane; remove it"
        )


def doubt_modes(scene: Scene, modes: int, highest: float) -> Iterator[str]:
    """What is probably not meant by loads above the highest mode that is kept [Hz], one sentence each."""
    if scene.solver.accuracy is not None or not (oscillating := oscillating_loads(scene)):
        return
    name = max(oscillating, key=lambda n: scene.loads[n].harmonic)
    at = scene.loads[name].harmonic * max(scene.frequencies)
    if at > highest:
        yield (
            f"excitation.frequency = {max(scene.frequencies):g}: the load {name} acts at {at:g} Hz, above the highest "
            f"of {modes} modes kept ({highest:.0f} Hz), so that the response is not resolved; raise reduction.modes, "
            f"or was rad/s meant ({max(scene.frequencies) / (2 * math.pi):.6g} Hz)?"
        )


def doubt_frequency(scene: Scene, stuck: float) -> Iterator[str]:
    """What is probably not meant by loads so far below the first full-stick mode [Hz], one sentence each."""
    highest = max(scene.frequencies, default=0.0)
    at = highest * max((scene.loads[name].harmonic for name in oscillating_loads(scene)), default=0)
    if KILOHERTZ[0] * stuck < at < KILOHERTZ[1] * stuck and highest < MOST_KILOHERTZ:
        yield (
            f"excitation.frequency = {highest:g} Hz is so far below the first full-stick mode ({stuck:.0f} Hz) that "
            f"the motion is as good as static; was {1e3 * highest:g} Hz (given in kHz) meant?"
        )


def doubt_drag(scene: Scene, drag: float) -> Iterator[str]:
    """What is probably not meant by damping that slows rigid motions at such a rate [1/s], one sentence each."""
    slowest = 2 * math.pi * min(scene.frequencies, default=0.0)
    if scene.damping.kind == "modal" and drag > DRAG * slowest > 0:
        yield (
            f'damping.kind = "modal" drags a body that only the joint holds: a loss factor of {drag / slowest:.2g} at '
            f'{slowest / (2 * math.pi):g} Hz where it slides freely or lifts off. If it does, take kind = "rayleigh" '
            "with alpha = 0, which damps no rigid motion"
        )


def hint_at_lengths(parameters: Mapping[str, object], usual: Mapping[str, object]) -> str:
    """What is probably not meant by a builder's parameters that do not fit, by their defaults; or ``''``."""
    for name, value in parameters.items():
        default = usual.get(name)
        numbers = isinstance(default, float) and isinstance(value, int | float)
        if numbers and default > 0 and MILLIMETRES[0] <= value / default <= MILLIMETRES[1]:
            return f"; {name} = {value:g} is far above its default, {default:g}: lengths are in m; were mm meant?"
    return ""


def oscillating_loads(scene: Scene) -> list[str]:
    """Names of the loads that excite a vibration."""
    return [name for name, load in scene.loads.items() if load.harmonic > 0]


def static_loads(scene: Scene) -> list[str]:
    """Names of the loads that act on average."""
    return [name for name, load in scene.loads.items() if load.harmonic == 0]


def laws_in_force(scene: Scene, flanks: Sequence[str] | None = None) -> dict[str, Contact]:
    """Where laws come from, as a key of the scene, and the joint's entries as they hold there.

    Args:
        scene: The scene.
        flanks: All flanks of the joint, which the mesh knows; None: those that the scene lists, or any.
    """
    own = {f"flanks.{name}": scene.laws_on(name) for name in scene.flanks}
    flanks = scene.listed_flanks if flanks is None else flanks
    covered = flanks is not None and set(flanks) <= set(scene.flanks)
    return own if covered else {"contact": scene.contact} | own


def _doubt_units(scene: Scene) -> Iterator[str]:
    """Values that are usual in other units than these."""
    for body, material in scene.materials.items():
        if material.young < SOFTEST:
            unit = "e9 Pa (GPa)" if material.young < 2000 else "e6 Pa (MPa)"
            young = f"{material.young:g}"
            yield f"materials.{body}.young = {young} Pa is softer than rubber; was {young}{unit} meant?"
        if not DENSITIES[0] <= material.density <= DENSITIES[1]:
            yield (
                f"materials.{body}.density = {material.density:g} kg/m^3 is that of no solid; was it given in "
                "g/cm^3 or t/mm^3?"
            )
    for key in ("ratio", "ratios"):
        given = getattr(scene.damping, key, 0.0)
        ratio = max(given) if isinstance(given, tuple) else given
        if ratio > MOST_DAMPED:
            yield (
                f"damping.{key}: {ratio:g} of the critical damping is more than structures have; was {ratio / 100:g} "
                "(given in per cent) meant?"
            )
    if scene.elasticity.thickness > THICKEST:
        thickness = f"{scene.elasticity.thickness:g}"
        yield f"elasticity.thickness = {thickness} m; was {thickness}e-3 (mm) meant?"
    said = {}  # once, however many flanks have it from [contact]
    for where, laws in laws_in_force(scene).items():
        own = scene.flanks.get(where.removeprefix("flanks."))
        gap, friction = (
            "contact" if own and getattr(own, key) is None else where for key in ("initial_gap", "friction")
        )
        if abs(laws.initial_gap) > WIDEST and "initial_gap" in list_parameters("normal", laws.normal):
            what = "gap" if laws.initial_gap > 0 else "interference"
            doubt = f"{gap}.initial_gap = {laws.initial_gap:g} m is no {what} of a joint; was it given in mm or µm?"
            said[doubt] = None
        if laws.tangential == "coulomb" and laws.friction > ROUGHEST:
            said[
                f"{friction}.friction = {laws.friction:g} is that of no dry joint; was {laws.friction / 100:g} (given "
                "in per cent) meant?"
            ] = None
    yield from said
    wear = {f"flanks.{name}.wear": own.wear for name, own in scene.flanks.items()}
    wear |= {"wear.coefficient": scene.wear and scene.wear.coefficient}
    for where, coefficient in wear.items():
        if coefficient is not None and coefficient > SOFTEST_SURFACE:
            yield (
                f"{where} = {coefficient:g} 1/Pa is far above that of any joint (the default is 1e-11); was "
                f"{coefficient * 1e-9:g} (given in mm^3/(N m)) or {coefficient * 1e-6:g} (given in 1/MPa, which is "
                "mm^2/N) meant?"
            )


def _check_harmonics(scene: Scene) -> Iterator[str]:
    if scene.solver.accuracy is not None:  # which chooses harmonics and samples itself
        return
    highest, samples = max(scene.harmonics), scene.solver.samples
    if samples is not None and samples <= 2 * highest:
        yield (
            f"solver.samples = {samples} a period cannot resolve harmonic {highest}; give at least {2 * highest + 1}"
        )
    for name, load in scene.loads.items():
        if load.harmonic not in scene.harmonics:
            yield (
                f"solver.harmonics = {list(scene.harmonics)} leave out harmonic {load.harmonic}, at which the load "
                f'"{name}" acts; include it'
            )
    joint = laws_in_force(scene)
    opening = [where for where, laws in joint.items() if find_kind("normal", laws.normal).opens]
    if opening and not static_loads(scene) and 0 not in scene.harmonics:
        yield (
            f"solver.harmonics = {list(scene.harmonics)} leave out harmonic 0, and {opening[0]}.normal = "
            f'"{joint[opening[0]].normal}" may part: a normal force without a mean pulls as much as it '
            "pushes; include 0"
        )
    pressed = [where for where, laws in joint.items() if laws.normal == "prescribed" and laws.normal_force]
    if pressed and 0 not in scene.harmonics:
        yield (
            f"solver.harmonics = {list(scene.harmonics)} leave out harmonic 0, at which {pressed[0]}.normal_force "
            "acts; include it"
        )


def _check_supports(scene: Scene) -> Iterator[str]:
    supports = scene.supports
    if (static := static_loads(scene)) and not supports.boundaries:
        yield (
            f'supports.clamp = []: nothing carries the static load "{static[0]}", and the bodies fly off together; '
            "name the boundary that is held"
        )
    for name in supports.clamp:
        if name in supports.hold:
            yield f'supports.hold.{name} = "{supports.hold[name]}": supports.clamp holds it in all directions; give one'
    for table, entries, vector, what in (
        ("loads", scene.loads, "force", "the force does nothing"),
        ("outputs", scene.outputs, "direction", "it never moves"),
    ):
        for name, entry in entries.items():
            if (boundary := getattr(entry, "boundary", None)) in supports.clamp:
                held = "supports.clamp holds it"
            elif axes := supports.hold.get(boundary):
                held = f"supports.hold holds it along {' and '.join(axes)}"
                if any(size and axis not in axes for axis, size in zip("xyz", getattr(entry, vector), strict=False)):
                    continue
            else:
                continue
            yield f'{table}.{name}.boundary = "{boundary}": {held}, so that {what}; name a boundary that is free'


def _check_ring(scene: Scene) -> Iterator[str]:
    supports, ring = scene.supports, scene.cyclic
    named = {"supports.clamp": supports.clamp, "supports.hold": supports.hold, "contact.flanks": scene.contact.flanks}
    named |= {f"loads.{name}.boundary": [getattr(load, "boundary", None)] for name, load in scene.loads.items()}
    named |= {f"outputs.{name}.boundary": [output.boundary] for name, output in scene.outputs.items()}
    for key, names in named.items() if ring else ():
        ends = ring.boundaries.values() if key == "contact.flanks" else ring.cuts  # flanks may be loaded, and held
        for end in sorted({*ends} & {*(names or ())}):
            yield f'{key}: "{end}" is an end of the sector, where [cyclic] goes on; name another'


def _check_accuracy(scene: Scene) -> Iterator[str]:
    asked = scene.solver.accuracy
    if asked is None:
        return
    for key in ("harmonics", "samples"):
        if key in scene.solver.model_fields_set and getattr(scene.solver, key) is not None:
            yield f"solver: accuracy = {asked:g} chooses {key} itself; give one of the two"


def _check_excitation(scene: Scene) -> Iterator[str]:
    oscillating = oscillating_loads(scene)
    if not (scene.loads or any(laws.acts_by_itself for laws in laws_in_force(scene).values())):
        yield (
            "loads: missing, and no flank has an interference (a negative initial_gap) or a normal_force: nothing "
            "moves; add a table [loads.NAME]"
        )
    if oscillating and not scene.frequencies:
        yield (
            f'excitation.frequency: missing, and the load "{oscillating[0]}" oscillates; give the frequency of '
            "harmonic 1 [Hz]"
        )
    if not oscillating and len(scene.frequencies) > 1:
        yield (
            f"excitation.frequency is a sweep over {len(scene.frequencies)} frequencies, and no load oscillates: every "
            "point would be the same static state; was harmonic = 1 meant in one of the loads?"
        )


def _check_laws(scene: Scene) -> Iterator[str]:
    joint, listed = laws_in_force(scene), scene.listed_flanks
    for name in () if listed is None else sorted({*scene.flanks} - {*listed}):
        hint = nearest(name, sorted({*listed} - {*scene.flanks}))
        there = "there, or to cyclic.flanks if the next sector lies on it" if scene.cyclic else "there"
        yield f"flanks.{name}: contact.flanks = {list(scene.contact.flanks)} leave this flank out; add it {there}{hint}"
    for where, laws in joint.items():
        if laws.normal == "prescribed" and laws.normal_force is None:
            yield f'{where}: normal = "prescribed" needs normal_force [N], the force of every pair'
    reads = lambda laws, law, key: key in list_parameters(law, getattr(laws, law))  # noqa: E731
    for key, (law, name) in READ_BY.items():
        if key in scene.contact.model_fields_set and getattr(scene.contact, key) is not None:
            found = getattr(scene.contact, law)
            if not any(reads(laws, law, key) for laws in (scene.contact, *joint.values())):
                yield f"contact: {_say_useless(key, law, found, name)}"
        for flank, own in scene.flanks.items():
            found = getattr(joint[f"flanks.{flank}"], law)
            if getattr(own, key) is not None and not reads(joint[f"flanks.{flank}"], law, key):
                source = "" if getattr(own, law) else ", as [contact] has it"
                yield f"flanks.{flank}: {_say_useless(key, law, found, name, source)}"

    known = {
        n
        for laws in joint.values()
        for law in ("normal", "tangential")
        for n in list_parameters(law, getattr(laws, law))
    }
    for where, given in {"contact": scene.contact, **{f"flanks.{n}": own for n, own in scene.flanks.items()}}.items():
        for name in given.parameters or {}:
            if name not in known:
                yield f"{where}.parameters.{name}: no law of the joint takes it{nearest(name, known)}"


def _say_useless(key: str, law: str, found: str, name: str, source: str = "") -> str:
    return f'{key} does nothing with {law} = "{found}"{source}; remove it, or set {law} = "{name}"'


def _check_wear(scene: Scene) -> Iterator[str]:
    for name, own in scene.flanks.items():
        if own.wear is None:
            continue
        if scene.wear is None:
            yield f"flanks.{name}.wear = {own.wear:g}: nothing wears without [wear], which says for how many cycles"
        elif own.wear and not (laws := scene.laws_on(name)).can_wear:
            yield (
                f'flanks.{name}.wear = {own.wear:g}: with normal = "{laws.normal}", tangential = "{laws.tangential}" '
                f'nothing slides and opens there; remove it, or set normal = "unilateral" and tangential = "coulomb"'
            )
    if scene.wear is None:
        return
    if not any(laws.can_wear for laws in laws_in_force(scene).values()):
        where, laws = next(iter(laws_in_force(scene).items()))
        yield (
            f'wear without a contact that slides and opens: {where} has normal = "{laws.normal}" and tangential = '
            f'"{laws.tangential}", so that no gap would grow; remove [wear], or set normal = "unilateral" and '
            'tangential = "coulomb"'
        )
    if not oscillating_loads(scene):
        yield "wear, and no load oscillates: nothing slides; was harmonic = 1 meant in one of the loads?"
    if len(scene.frequencies) > 1:
        yield (
            f"wear and a sweep over {len(scene.frequencies)} frequencies: cycles of which one? Give one frequency, or "
            "remove [wear]"
        )
