"""Contact problems at the edge of what is well posed, by name: grazing, redundant, idle, badly scaled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from models import dovetail, lap_joint, shake

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel
from ewr_fenicsx.balance.balance import HarmonicBalance


def shake_dovetail(harmonics: int = 5, friction: float = 0.3, frequency: float = 360.0, **laws) -> ContactProblem:
    """The dovetail of trusses under its pull, shaken."""
    return ContactProblem(dovetail(), ContactLaws(friction=friction, **laws), frequency, harmonics)


def just_touch() -> ContactProblem:
    """The lightest pair of the lap joint, which nothing presses and no load opens: closed at zero force at rest."""
    model = lap_joint()
    bolts = ContactProblem(model, ContactLaws(), 1.0, 1)
    forces, _ = HarmonicBalance(bolts.system).full_stick
    press = forces[0].real[: model.pairs].copy()
    press[:-1] = 0.0  # take the last pair's bolt off
    return replace(bolts, load={**model.load, 0: model.load[0] + model.normal.T @ press}, frequency=330.0, harmonics=9)


def just_lift() -> ContactProblem:
    """The full-stick normal force of one pair touches zero once a period."""
    model = lap_joint()
    problem = ContactProblem(model, ContactLaws("unilateral", "bonded"), 200.0, 9)
    forces, _ = HarmonicBalance(problem.system).full_stick
    factor = np.min(forces[0].real / np.abs(forces[1]))
    return replace(problem, model=shake(model, factor))


def meet_friction_limit() -> ContactProblem:
    """The full-stick friction force of one pair touches its limit exactly, and goes no further."""
    model = lap_joint()
    laws = ContactLaws("prescribed", normal_force=100.0, friction=0.3)
    problem = ContactProblem(model, laws, 200.0, 5)
    forces, _ = HarmonicBalance(problem.system).full_stick
    factor = 30.0 / np.max(np.abs(forces[1]))
    return replace(problem, model=shake(model, factor))


def repeat_rows(model: ReducedModel, times: int | Sequence[int]) -> ReducedModel:
    """The same model with each of its pairs several times."""
    return replace(
        model,
        normal=np.repeat(model.normal, times, axis=0),
        tangential=np.repeat(model.tangential, times, axis=0),
        pair_area=None,
    )


def spread_areas(ratio: float) -> ContactProblem:
    """The lap joint pressed evenly over tributary areas that span ``ratio``: so do the preloads of its pairs.

    Rows and flexibilities stay those of the nodes: a light pair has to obey its laws beside heavy ones.
    """
    model = lap_joint()
    area = np.geomspace(1.0, ratio, model.pairs)
    area *= model.pair_area.sum() / area.sum()
    bolts = 700.0 * area / area.sum()
    load = {**model.load, 0: -model.normal.T @ bolts}
    return ContactProblem(replace(model, pair_area=area, load=load), ContactLaws(friction=0.3), 330.0, 5)


def stiffen_pairs(condition: float) -> ContactProblem:
    """Two bodies held by springs from soft to stiff: the contact compliance has the condition number asked for."""
    pairs = 8
    stiffness = 1e6 * np.geomspace(1.0, condition, pairs)
    matrix = np.kron(np.diag(stiffness), np.eye(2))
    mass = matrix / (2 * np.pi * 500.0) ** 2 * np.repeat(np.linspace(1.0, 2.0, pairs), 2)
    normal, tangential = np.kron(np.eye(pairs), [[0.0, 1.0]]), np.kron(np.eye(pairs), [[1.0, 0.0]])
    forced = np.tile([0.6, 0.4j], pairs)
    model = ReducedModel(
        mass=mass,
        damping=1e-2 * matrix / (2 * np.pi * 500.0),
        stiffness=matrix,
        normal=normal,
        tangential=tangential,
        load={0: np.tile([0.0, -1.0], pairs), 1: forced},
        outputs={"tip": np.eye(2 * pairs)[0]},
    )
    return ContactProblem(model, ContactLaws(friction=0.3), 200.0, 5)


def press_one_pair(pairs: int, harmonics: int = 5) -> ContactProblem:
    """A massless foot on springs under a mass, with its pair once or many times over: the pairs share one motion."""
    stiffness = np.array(
        [[2.0, 0.4, -1.0, -0.4], [0.4, 2.7, -0.4, -1.2], [-1.0, -0.4, 1.1, 0.4], [-0.4, -1.2, 0.4, 1.4]]
    )
    mass = np.diag([1.0, 1.0, 0.0, 0.0])
    one = ReducedModel(
        mass=mass,
        damping=0.03 * (stiffness + mass),
        stiffness=stiffness,
        normal=[[0.0, 0.0, 0.0, 1.0]],
        tangential=[[0.0, 0.0, 1.0, 0.0]],
        load={0: [0.0, 0.0, 0.0, -1.0], 1: [1.6, 1j, 0.0, 0.0]},
        outputs={"tip": [1.0, 0.0, 0.0, 0.0]},
    )
    return ContactProblem(repeat_rows(one, pairs), ContactLaws(friction=0.3), 0.2, harmonics)


def release_held_body(load: complex) -> ContactProblem:
    """The lap joint without its bolts: both beams are clamped, nothing presses the pairs."""
    model = lap_joint(excitation=load)
    return ContactProblem(model, ContactLaws(friction=0.3), 330.0, 5, load={1: model.load[1]})


DEGENERATE: dict[str, Callable[[], ContactProblem]] = {
    "a pair just touches at rest": just_touch,
    "a pair is just about to lift off": just_lift,
    "friction limit met exactly": meet_friction_limit,
    "zero excitation": lambda: replace(shake_dovetail(), load={0: dovetail().load[0]}),
    "zero excitation, zero preload": lambda: replace(shake_dovetail(), load={}),
    "zero preload, body held, shaken": lambda: release_held_body(5.0),
    "zero preload, body held, barely shaken": lambda: release_held_body(1e-9),
    "redundant pairs": lambda: ContactProblem(repeat_rows(dovetail(), 2), ContactLaws(friction=0.3), 360.0, 5),
    "one pair of six twice": lambda: ContactProblem(
        repeat_rows(dovetail(), [1, 2, 1, 1, 1, 1]), ContactLaws(friction=0.3), 360.0, 5
    ),
    "compliance condition 1e10": lambda: stiffen_pairs(1e10),
    "areas spanning 1e4": lambda: spread_areas(1e4),
    "one pair": lambda: press_one_pair(1),
    "fifty identical pairs": lambda: press_one_pair(50),
    "one thousand identical pairs": lambda: press_one_pair(1000, harmonics=1),
    "no friction at all": lambda: shake_dovetail(friction=0.0),
}
