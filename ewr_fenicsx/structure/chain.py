"""From a scene to its contact problem: mesh, matrices, interface and reduced model, one after the other and timed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from mpi4py import MPI

from ewr_fenicsx.errors import InterfaceError, MeshError, ModelError, ModesError, SceneError, nearest
from ewr_fenicsx.laws.contact_laws import ContactLaws, JointLaws
from ewr_fenicsx.laws.law_kinds import list_parameters
from ewr_fenicsx.model.reduced_model import ReducedModel
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.scene.scene import Scene
from ewr_fenicsx.scene.scene_joint import Contact
from ewr_fenicsx.scene.scene_sense import (
    doubt_closure,
    doubt_drag,
    doubt_frequency,
    doubt_lengths,
    doubt_modes,
    doubt_simplices,
    laws_in_force,
)
from ewr_fenicsx.scene.scene_structure import Material, ModalDamping, RayleighDamping, RotationLoad, doubt_materials
from ewr_fenicsx.structure import elasticity, materials
from ewr_fenicsx.structure._compat import measure_compilation
from ewr_fenicsx.structure.boundaries import doubt_cracks
from ewr_fenicsx.structure.elasticity import Structure, assemble_structure
from ewr_fenicsx.structure.interface import Interface, doubt_boundaries, doubt_drawn_gaps, pair_interface
from ewr_fenicsx.structure.mesh import JointMesh, Ring, build_mesh, measure_extent
from ewr_fenicsx.structure.reduction import CraigBampton, reduce_structure
from ewr_fenicsx.structure.rigid_motions import doubt_pieces
from ewr_fenicsx.structure.sector_cuts import find_cuts

Progress = Callable[[str, float | None], None]  # (stage, None) as it begins, (stage, seconds) when it is done
JIT = "JIT"  # compilation of forms and spaces
SHOWN = 0.01  # seconds of it that are worth a line on the way


@dataclass
class Stopwatch:
    """Times named stages and tells a progress display of them; a stage within another one counts for itself alone.

    What dolfinx compiles in any of them is a stage of its own, ``JIT``.
    """

    progress: Progress | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    _within: tuple[float, float] = (0.0, 0.0)  # of stages inside the current one: spent, and on compilation

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        if self.progress:
            self.progress(name, None)
        outer, self._within = self._within, (0.0, 0.0)
        start, before = time.perf_counter(), measure_compilation()
        yield
        spent, compiled = time.perf_counter() - start, measure_compilation() - before
        inside, compiled_inside = self._within
        self._within = outer[0] + spent, outer[1] + compiled
        compiled_here = compiled - compiled_inside
        own = {name: spent - inside - compiled_here} | ({JIT: compiled_here} if compiled_here else {})
        self.seconds = add_times(self.seconds, own)
        for stage, seconds in own.items() if self.progress else ():
            if stage == name:
                self.progress(stage, seconds)
            elif seconds >= SHOWN:
                self.progress(stage, None)
                self.progress(stage, seconds)


def add_times(*times: Mapping[str, float]) -> dict[str, float]:
    """Seconds by stage, added up over several mappings."""
    return {stage: sum(t.get(stage, 0.0) for t in times) for t in times for stage in t}


@dataclass(frozen=True)
class Chain:
    """Everything from the scene to the reduced model; ``seconds`` by stage, ``doubts`` of mesh, joint and modes."""

    scene: Scene
    reduction: CraigBampton
    seconds: Mapping[str, float]
    doubts: tuple[str, ...] = ()

    @property
    def structure(self) -> Structure:
        """What was reduced."""
        return self.reduction.structure

    @property
    def mesh(self) -> JointMesh:
        """With its named bodies and boundaries."""
        return self.structure.mesh

    @property
    def interface(self) -> Interface:
        """The pairs."""
        return self.reduction.interface

    def pose(self) -> ContactProblem:
        """The contact problem that its scene poses, anew."""
        return pose_problem(self.scene, self.reduction.model, self.interface)


def build_chain(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD, progress: Progress | None = None) -> Chain:
    """Builds mesh, matrices, interface and reduced model of a scene.

    Args:
        scene: What to build.
        comm: Ranks that share the mesh; the reduced model is the same on each.
        progress: Called as ``progress(stage, None)`` when a stage begins and ``progress(stage, seconds)`` when it ends.

    Raises:
        SceneError: No scene, or one that names a body or boundary that the mesh does not have, or a law that lacks a
            parameter.
        MeshError, InterfaceError, ModesError: The geometry does not give a joint that can be solved.
    """
    if not isinstance(scene, Scene):
        raise SceneError(f"scene = {scene!r}; give a scene as load_scene(path) returns it")
    check_laws(scene, scene.listed_flanks or tuple(scene.flanks) or None)  # before a mesh is made for nothing
    watch = Stopwatch(progress)
    with watch.stage("mesh"):
        mesh = build_mesh(scene.geometry.source, scene.geometry.parameters, comm)
        check_names(scene, mesh)
        check_plane(scene, mesh)
        doubts = (*doubt_lengths(scene, measure_extent(mesh)), *doubt_cracks(mesh))
    with adding(doubts):
        with watch.stage("matrices"):
            structure = assemble_structure(
                mesh,
                materials=_materials(scene, mesh),
                thickness=scene.elasticity.thickness,
                plane=scene.elasticity.plane,
                degree=scene.elasticity.degree,
                clamp=scene.supports.clamp,
                hold=scene.supports.hold,
                damping=_damping(scene),
                loads=[_load(name, load) for name, load in scene.loads.items()],
                outputs=[elasticity.OutputSpec(name, o.boundary, o.direction) for name, o in scene.outputs.items()],
            )
        nodes, locks = structure.space.dofmap.dof_layout.num_dofs, scene.elasticity.locks(mesh.dimension)
        doubts += (*doubt_materials(scene.materials, mesh.bodies, locks), *doubt_simplices(mesh.dimension, nodes))
        with watch.stage("interface"):
            contact, followed = scene.contact, [*scene.loads.values(), *scene.outputs.values()]
            ring = _ring(scene, mesh)
            elsewhere = [*scene.supports.boundaries, *(scene.cyclic.boundaries.values() if ring else ())]
            interface = pair_interface(
                structure,
                contact.flanks,
                body_a=contact.body_a,
                body_b=contact.body_b if _has_body_b(scene, mesh) else None,
                ring=ring,
                tolerance=contact.pair_tolerance,
                in_use=[*elsewhere, *(getattr(entry, "boundary", None) for entry in followed)],
            )
            joint = interface.flanks, contact.body_a, contact.body_b
            doubts += (*doubt_drawn_gaps(interface), *doubt_boundaries(structure, *joint, scene.supports.boundaries))
            cuts = find_cuts(structure, interface, ring) if ring else None
        check_flanks(scene, interface)
        check_laws(scene, interface.flanks)  # those of flanks that only the mesh knows, too
        with watch.stage("reduction"):
            reduction = reduce_structure(structure, interface, modes=scene.reduction.modes, cuts=cuts)
    modes, stuck = reduction.fixed_interface_frequencies, float(reduction.full_stick.frequency[0])
    doubts += (*doubt_closure(scene, mesh.dimension), *doubt_modes(scene, len(modes), float(max(modes))))
    doubts += (*doubt_frequency(scene, stuck), *doubt_drag(scene, reduction.rigid_drag), *doubt_pieces(structure))
    return Chain(scene, reduction, watch.seconds, doubts)


@contextmanager
def adding(doubts: Sequence[str]) -> Iterator[None]:
    """Around what may fail of what was probably not meant: its message ends with these doubts.

    Raises:
        MeshError, InterfaceError, ModesError: With the longer message.
    """
    try:
        yield
    except (MeshError, InterfaceError, ModesError) as error:
        raise type(error)("; ".join([str(error), *doubts])) from error


def build_reduced_model(scene: Scene) -> ReducedModel:
    """The reduced model of a scene: matrices, contact rows, loads and outputs.

    Laws, frequency and harmonics stay in the scene: ``pose_problem`` makes a problem of both.

    Args:
        scene: As ``load_scene`` returns it.

    Raises:
        EwrError: As ``build_chain``.
    """
    return build_chain(scene).reduction.model


def pose_problem(scene: Scene, model: ReducedModel, interface: Interface | None = None) -> ContactProblem:
    """The contact problem that a scene poses on its reduced model.

    Args:
        scene: The scene.
        model: Its reduced model.
        interface: Its pairs; only a scene whose flanks have laws of their own needs it.

    Raises:
        ModelError: Laws, harmonics or samples do not fit together.
        SceneError: Flanks have laws of their own and no interface says which pairs are theirs.
    """
    solver, harmonics = scene.solver, scene.solver.harmonics
    if solver.accuracy is not None:  # where it begins is not decisive, but loads must have their harmonics
        harmonics = max([harmonics, *(load.harmonic for load in scene.loads.values())])
    frequency = next(iter(scene.frequencies), 0.0)
    return ContactProblem(
        model,
        lay_laws(scene, interface),
        frequency=frequency,
        harmonics=harmonics if frequency else 0,
        samples=solver.samples if frequency else None,
        rho_normal=solver.rho_normal,
        rho_tangential=solver.rho_tangential,
        closure=solver.closure,
    )


def lay_laws(scene: Scene, interface: Interface | None = None) -> JointLaws:
    """The laws of a scene: one for all pairs, or by groups of pairs where flanks have their own.

    Raises:
        SceneError: As ``pose_problem``.
    """
    if not scene.flanks:
        return _laws(scene.contact)
    if interface is None:
        remedy = "give pose_problem the chain's interface as well, or take build_chain(scene).pose()"
        raise SceneError(f"{scene.where}: flanks have laws of their own; {remedy}")
    groups: dict[str, tuple[ContactLaws, list[int]]] = {}
    for k, flank in enumerate(interface.flanks):
        own, pairs = scene.laws_on(flank), np.flatnonzero(interface.flank_of_pair == k).tolist()
        groups.setdefault(repr(own), (_laws(own), []))[1].extend(pairs)
    return [(pairs, laws) for laws, pairs in groups.values()]


def spread_wear(scene: Scene, interface: Interface) -> np.ndarray:
    """Wear coefficient of each pair, ``(K_c,)`` [1/Pa]; zero where nothing wears."""
    own = {name: flank.wear for name, flank in scene.flanks.items() if flank.wear is not None}
    usual = scene.wear.coefficient if scene.wear else 0.0
    of_flank = [own.get(name, usual) if scene.laws_on(name).can_wear else 0.0 for name in interface.flanks]
    return np.array(of_flank)[interface.flank_of_pair]


def check_names(scene: Scene, mesh: JointMesh) -> None:
    """Checks that the mesh has every body and boundary that the scene names.

    Raises:
        SceneError: Names the scene's key, the name, and the nearest that the mesh has.
    """
    contact = scene.contact
    bodies = {f"materials.{body}": body for body in scene.materials}
    bodies |= {"contact.body_a": contact.body_a}
    bodies |= {"contact.body_b": contact.body_b} if _has_body_b(scene, mesh) else {}
    boundaries = {f"supports.clamp[{k}]": name for k, name in enumerate(scene.supports.clamp)}
    boundaries |= {f"supports.hold.{name}": name for name in scene.supports.hold}
    if scene.cyclic:
        boundaries |= {f"cyclic.{key}": name for key, name in scene.cyclic.boundaries.items()}
    boundaries |= {f"contact.flanks[{k}]": name for k, name in enumerate(contact.flanks or ())}
    boundaries |= {
        f"{table}.{name}.boundary": entry.boundary
        for table, entries in (("loads", scene.loads), ("outputs", scene.outputs))
        for name, entry in entries.items()
        if not isinstance(entry, RotationLoad)
    }
    for what, keys, known in (("body", bodies, mesh.bodies), ("boundary", boundaries, mesh.boundaries)):
        for key, name in keys.items():
            if name not in known:
                hint = nearest(name, known)
                if key == "supports.clamp[0]" and "clamp" not in scene.supports.model_fields_set:
                    hint += "; that is the default: name what is clamped, or give supports.clamp = []"
                raise SceneError(
                    f'{scene.where}: {key} = "{name}": {scene.geometry.source.name} has no physical group of that name '
                    f"for a {what}, only {', '.join(sorted(known)) or 'unnamed ones'}{hint}"
                )


def check_plane(scene: Scene, mesh: JointMesh) -> None:
    """Checks that a scene of solids says nothing of planes.

    Raises:
        SceneError: Names the key.
    """
    if mesh.dimension == 3 and (stated := scene.elasticity.model_fields_set & {"plane", "thickness"}):
        names = " and ".join(f"elasticity.{name}" for name in sorted(stated))
        raise SceneError(f"{scene.where}: {names}: the mesh is of solids, for which this means nothing; remove it")


def check_laws(scene: Scene, flanks: Sequence[str] | None) -> None:
    """Checks that the laws have all their parameters.

    Args:
        scene: The scene.
        flanks: As in ``laws_in_force``.

    Raises:
        SceneError: Names the law, what it lacks, and the flank if there are several.
    """
    for where, joint in laws_in_force(scene, flanks).items():
        try:
            _laws(joint)
        except ModelError as error:
            raise SceneError(f"{scene.where}: {where}: {error}") from None


def check_flanks(scene: Scene, interface: Interface) -> None:
    """Checks that flanks with laws of their own are flanks of the joint.

    Raises:
        SceneError: Names the flank and the nearest that the joint has.
    """
    for name in scene.flanks:
        if name not in interface.flanks:
            raise SceneError(
                f"{scene.where}: flanks.{name}: the joint has no flank of that name, only "
                f"{', '.join(interface.flanks)}{nearest(name, interface.flanks)}"
            )


def _laws(joint: Contact) -> ContactLaws:
    known = {*list_parameters("normal", joint.normal), *list_parameters("tangential", joint.tangential)}
    return ContactLaws(
        normal=joint.normal,
        tangential=joint.tangential,
        friction=joint.friction,
        normal_force=joint.normal_force if joint.normal == "prescribed" else None,
        initial_gap=joint.initial_gap,
        static_friction=joint.static_friction,
        parameters={name: value for name, value in joint.parameters.items() if name in known},
    )


def _materials(scene: Scene, mesh: JointMesh) -> dict[str, materials.Material]:
    stated = {body: scene.materials.get(body, Material()) for body in mesh.bodies}
    return {body: materials.Material(m.young, m.poisson, m.density) for body, m in stated.items()}


def _damping(scene: Scene) -> materials.Damping:
    damping = scene.damping
    if isinstance(damping, RayleighDamping):
        return materials.Rayleigh(damping.alpha, damping.beta)
    if isinstance(damping, ModalDamping):
        return materials.PerMode(damping.ratio)
    return materials.RayleighRatios(damping.frequencies, damping.ratios)


def _has_body_b(scene: Scene, mesh: JointMesh) -> bool:
    """Not where all flanks are between the sectors of a ring, and nobody named a second body."""
    may_lack = scene.cyclic and scene.cyclic.flanks and "body_b" not in scene.contact.model_fields_set
    return not may_lack or scene.contact.body_b in mesh.bodies


def _ring(scene: Scene, mesh: JointMesh) -> Ring | None:
    """What a scene says of the ring, of which the mesh is a sector; collective."""
    if (asked := scene.cyclic) is None:
        return None
    dimension, extent = mesh.dimension, measure_extent(mesh)
    centre = asked.centre if "centre" in asked.model_fields_set else (0.0,) * dimension
    if len(centre) != dimension:
        raise SceneError(
            f"{scene.where}: cyclic.centre = {list(centre)}: the mesh is {dimension}-D; give {dimension} components"
        )
    if dimension == 2 and any(asked.axis[:2]):
        raise SceneError(f"{scene.where}: cyclic.axis = {list(asked.axis)}: a plane turns about an axis normal to it")
    for name, load in scene.loads.items():
        fits = isinstance(load, RotationLoad) and len(load.centre) == dimension
        if fits and _are_apart(load, centre, asked.axis, extent):
            raise SceneError(
                f"{scene.where}: loads.{name} turns the ring about another axis than its own, and no two sectors are "
                "loaded alike; give it the centre and axis of cyclic"
            )
    return Ring(asked.sectors, asked.engine_order, asked.low, asked.high, centre, asked.axis, asked.flanks)


def _are_apart(load: RotationLoad, centre: Sequence[float], axis: Sequence[float], extent: float) -> bool:
    """Whether a rotation is about another axis, as far as centres are told to six digits, on a mesh of this extent."""
    along, other = (np.array(vector) / np.linalg.norm(vector) for vector in (axis, load.axis))
    centres = np.zeros((2, 3))
    centres[:, : len(centre)] = centre, load.centre
    distance = np.linalg.norm(np.cross(centres[1] - centres[0], along))
    return bool(np.linalg.norm(np.cross(other, along)) > 1e-6 or distance > 1e-6 * max(np.abs(centres).max(), extent))


def _load(name: str, load) -> elasticity.LoadSpec:
    if isinstance(load, RotationLoad):
        return elasticity.CentrifugalForce(name, load.speed * 2 * math.pi / 60, load.centre, load.axis)
    return elasticity.BoundaryForce(name, load.boundary, load.force, load.harmonic, math.radians(load.phase))
