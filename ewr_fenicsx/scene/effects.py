"""Which physical effects a scene calls for, why, and what each of them costs: what `ewr info` tells."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.laws.law_kinds import find_kind
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.scene.scene import Scene
from ewr_fenicsx.scene.scene_joint import Contact
from ewr_fenicsx.scene.scene_sense import laws_in_force, oscillating_loads
from ewr_fenicsx.scene.scene_structure import ForceLoad, RotationLoad
from ewr_fenicsx.solution.symmetry import find_idle_harmonics, leave_out_idle

Joint = Mapping[str, Contact]  # key of the scene -> laws that hold there
SOLVE = "solve"  # the stage of a run that the laws share, in proportion to their unknowns
OF_STAGES = {"frequency sweep": ("sweep", "stability"), "wear": ("wear",)}  # effects with stages of their own


@dataclass(frozen=True)
class Effect:
    """One physical effect.

    Attributes:
        name: What people call it.
        on: Whether the scene has it.
        why: Which entries say so.
        unknowns: Unknowns that it adds to the contact solve; None where that is not known yet, or left to the solver.
        rows: Contact rows that it adds; None where that is not known yet.
        share: Of the time of the last run; None where there is none, or none to speak of.
    """

    name: str
    on: bool
    why: str
    unknowns: int | None = None
    rows: int | None = None
    share: float | None = None


def list_effects(
    scene: Scene,
    problem: ContactProblem | None = None,
    seconds: Mapping[str, float] | None = None,
    flanks: Sequence[str] | None = None,
) -> Iterator[Effect]:
    """The effects that a scene has and has not, in the order in which they enter the problem.

    Args:
        scene: The scene.
        problem: What it poses: with it, each effect tells its unknowns and rows.
        seconds: Time of each stage of an earlier run: with it, each effect tells its share.
        flanks: All flanks of the joint: with them, ``[contact]`` counts only where it holds on one of them.
    """
    costs = count_costs(problem) if problem else {}
    total = sum(unknowns for unknowns, _ in costs.values())
    forget = lambda effect: replace(effect, unknowns=None) if leaves_choice(scene) else effect  # noqa: E731
    for effect in _list_bare(scene, problem, laws_in_force(scene, flanks)):
        if problem:
            unknowns, rows = costs.pop(effect.name, (0, 0))
            effect = replace(effect, unknowns=unknowns, rows=rows)
        yield forget(_time(effect, seconds, total))
    for name, (unknowns, rows) in costs.items():  # laws of the user's own
        effect = Effect(name, True, "a law registered outside the package", unknowns, rows)
        yield forget(_time(effect, seconds, total))


def leaves_choice(scene: Scene) -> bool:
    """Whether harmonics and samples, and so the unknowns, are left to the solver."""
    return scene.solver.accuracy is not None and bool(scene.frequencies)


def count_costs(problem: ContactProblem) -> dict[str, tuple[int, int]]:
    """Unknowns and rows of the contact solve by effect; they add up to those of the solve."""
    kept = leave_out_idle(problem)
    system, tangents = kept.system, kept.model.tangents
    if not system.laws:
        return {}
    balance = HarmonicBalance(system)
    of_row, mean = balance.unknown.sum(axis=0), int(balance.basis.has_mean)
    costs: dict[str, tuple[int, int]] = {}

    def add(name: str, unknowns: int, rows: int) -> None:
        before = costs.get(name, (0, 0))
        costs[name] = (before[0] + unknowns, before[1] + rows)

    for pairs, laws in kept.groups:
        for kind in laws.kinds:
            rows = [system.row_of(d, pairs) for d in (*kind.acts_in(tangents), *kind.holds(tangents))]
            rows = np.concatenate([np.zeros(0, dtype=int), *rows])
            rows = rows[rows >= 0]
            means = mean * rows.size if getattr(kind, "static_friction", "zero") != "zero" else 0
            if rows.size:
                add(kind.effect or type(kind).__name__, int(of_row[rows].sum()) - means, rows.size)
            if means:
                add("static friction", means, 0)
    if balance.rigid:
        add("floating bodies", balance.rigid, 0)
    return costs


def _time(effect: Effect, seconds: Mapping[str, float] | None, total: int) -> Effect:
    if not seconds or not effect.on:
        return effect
    if own := [seconds[stage] for stage in OF_STAGES.get(effect.name, ()) if stage in seconds]:
        return replace(effect, share=sum(own) / sum(seconds.values()))
    if effect.unknowns and SOLVE in seconds:
        return replace(effect, share=effect.unknowns / total * seconds[SOLVE] / sum(seconds.values()))
    return effect


def _list_bare(scene: Scene, problem: ContactProblem | None, joint: Joint) -> Iterator[Effect]:
    yield from _list_laws(scene, joint)
    if problem:
        rigid = problem.system.model.rigid_modes.shape[1]
        yield Effect("floating bodies", rigid > 0, f"{rigid} rigid-body motions that no support or bond holds")
    ring = scene.cyclic
    why = f"cyclic: {ring.sectors} sectors, engine order {ring.engine_order}" if ring else "no [cyclic]"
    yield Effect("cyclic symmetry", ring is not None, why)
    yield from _list_loads(scene)
    yield _tell_harmonics(scene, problem)
    yield from _list_studies(scene, joint)


def _list_laws(scene: Scene, joint: Joint) -> Iterator[Effect]:
    def by_law(name: str, law: str, *kinds: str, tell: str = "") -> Effect:
        """On where some part of the joint has one of the laws; ``tell``: another entry of that part."""
        has = {where: (laws, kind) for where, laws in joint.items() if (kind := getattr(laws, law)) in kinds}
        why = [
            f'{where}.{law} = "{kind}"' + (f", {tell} = {getattr(laws, tell):g}" if tell else "")
            for where, (laws, kind) in has.items()
        ]
        others = ", ".join(sorted({getattr(laws, law) for laws in joint.values()}))
        return Effect(name, bool(has), "; ".join(why) or f"{law}: {others}")

    parting = {where: laws for where, laws in joint.items() if find_kind("normal", laws.normal).opens}
    yield by_law("separation", "normal", *{laws.normal for laws in parting.values()})
    yield by_law("prescribed preload", "normal", "prescribed", tell="normal_force")
    rubbing = [laws for laws in joint.values() if laws.tangential == "coulomb" and laws.friction > 0]
    yield replace(by_law("friction", "tangential", "coulomb", tell="friction"), on=bool(rubbing))
    means = sorted({laws.static_friction for laws in rubbing})
    decided = ", ".join(means) or "no friction"
    yield Effect("static friction", any(mean != "zero" for mean in means), f"static_friction: {decided}")
    bonds = [by_law("bonded parts", law, "bonded") for law in ("normal", "tangential")]
    yield Effect("bonded parts", any(b.on for b in bonds), "; ".join(b.why for b in bonds if b.on) or "no bonded law")
    yield by_law("frictionless flanks", "tangential", "frictionless")
    for effect, sign in (("initial gap", 1), ("interference", -1)):
        gaps = [f"{w}.initial_gap = {c.initial_gap:g} m" for w, c in parting.items() if sign * c.initial_gap > 0]
        yield Effect(effect, bool(gaps), "; ".join(gaps) or f"no initial_gap {'above' if sign > 0 else 'below'} 0 m")
    mixed = ", ".join(f"[flanks.{name}]" for name in scene.flanks)
    yield Effect("mixed flanks", bool(scene.flanks), mixed or "no [flanks]")


def _list_loads(scene: Scene) -> Iterator[Effect]:
    kinds = {
        "static load": [n for n, load in scene.loads.items() if isinstance(load, ForceLoad) and load.harmonic == 0],
        "centrifugal load": [n for n, load in scene.loads.items() if isinstance(load, RotationLoad)],
        "harmonic load": oscillating_loads(scene),
    }
    for name, loads in kinds.items():
        yield Effect(name, bool(loads), f"loads {', '.join(loads)}" if loads else "no such load")


def _tell_harmonics(scene: Scene, problem: ContactProblem | None) -> Effect:
    idle = find_idle_harmonics(problem) if problem else None
    if leaves_choice(scene):
        why = f"solver.accuracy = {scene.solver.accuracy:g} chooses the harmonics"
        return Effect(
            "odd harmonics only", bool(idle and idle.orders), f"{idle.why}; {why}" if idle and idle.why else why
        )
    if idle and idle.orders:
        why = f"{idle.why}; harmonics {', '.join(map(str, idle.orders))} left out"
        return Effect("odd harmonics only", bool(oscillating_loads(scene)), why)
    return Effect("odd harmonics only", all(h % 2 for h in scene.harmonics), f"harmonics {list(scene.harmonics)}")


def _list_studies(scene: Scene, joint: Joint) -> Iterator[Effect]:
    frequencies, wear = scene.frequencies, scene.wear
    if len(frequencies) > 1:
        why = f"{len(frequencies)} frequencies, {frequencies[0]:g} to {frequencies[-1]:g} Hz"
    else:
        why = f"excitation.frequency = {frequencies[0]:g} Hz" if frequencies else "no frequency"
    yield Effect("frequency sweep", len(frequencies) > 1, why)
    why = "no [wear]"
    if wear:
        own = {f"flanks.{name}": flank.wear for name, flank in scene.flanks.items() if flank.wear is not None}
        worn = [place for place, laws in joint.items() if laws.can_wear and own.get(place) != 0]
        where = ", ".join(f"{place} ({own[place]:g} 1/Pa)" if place in own else place for place in worn)
        why = f"wear.coefficient = {wear.coefficient:g} 1/Pa, {wear.cycles} cycles, on {where}"
    yield Effect("wear", wear is not None, why)
