"""Small reduced models for tests: a few coordinates each, every number chosen by hand or by a seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel


def friction_oscillator(
    *, mass: float = 1.0, damping: float = 0.0, stiffness: float = 1.0, load: Mapping[int, complex] | None = None
) -> ReducedModel:
    """One mass on a spring, rubbing on the ground: no normal motion, so its normal force must be prescribed."""
    load = {1: 1.0} if load is None else load
    return ReducedModel(
        mass=[[mass]],
        damping=[[damping]],
        stiffness=[[stiffness]],
        tangential=[[1.0]],
        load={h: [amplitude] for h, amplitude in load.items()},
        outputs={"tip": [1.0]},
    )


def lift_off_oscillator(
    *, preload: float = 1.0, excitation: complex = 1.0, damping: float = 0.03, contact_mass: float = 0.0
) -> ReducedModel:
    """Two masses in a plane, coupled by oblique springs; the second is pressed on the ground, rubs and lifts off.

    Coordinates ``(x1, y1, x2, y2)``; natural frequencies of order one [rad/s]. A mass that lands on the ground bounces
    as no law here says how: without ``contact_mass`` lift-off is well posed.
    """
    coupling = np.array([[1.0, 0.4], [0.4, 1.2]])
    stiffness = np.block([[coupling, -coupling], [-coupling, coupling]]) + np.diag([1.0, 1.5, 0.1, 0.2])
    mass = np.diag([1.0, 1.0, contact_mass, contact_mass])
    return ReducedModel(
        mass=mass,
        damping=damping * (stiffness + mass),
        stiffness=stiffness,
        normal=[[0.0, 0.0, 0.0, 1.0]],
        tangential=[[0.0, 0.0, 1.0, 0.0]],
        load={0: [0.0, 0.0, 0.0, -preload], 1: excitation * np.array([0.8, 0.5j, 0.0, 0.0])},
        outputs={"tip": [1.0, 0.0, 0.0, 0.0]},
    )


def repeat_first_pair(model: ReducedModel) -> ReducedModel:
    """The model with its first pair twice: how the two share their force is not determined."""
    normal, tangential = (np.vstack([rows, rows[:1]]) for rows in (model.normal, model.tangential))
    return replace(model, normal=normal, tangential=tangential, pair_area=None)


def dovetail(
    *, pull: float = 1000.0, excitation: complex = 60.0, damping: float = 2e-6, seed: int = 3, angle: float = 50.0
) -> ReducedModel:
    """A floating blade in a grounded disk, 2-D: three pairs on each of two flanks that close under the pull.

    Both bodies are trusses of unequal springs, so the blade has exactly three rigid modes. The flanks' normals are
    ``angle`` degrees from the horizontal, within a few degrees from pair to pair. SI units: first full-stick mode near
    1 kHz, coordinates: seven nodes of the blade (the last is the tip), then six of the disk.
    """
    rng = np.random.default_rng(seed)
    depth = np.array([0.0, 0.008, 0.016])
    right = np.column_stack([0.012 - depth * np.sin(np.radians(angle)), depth * np.cos(np.radians(angle))])
    flanks = np.vstack([right, right * [-1.0, 1.0]])
    blade = np.vstack([flanks, [[0.001, 0.06]]])
    stiffness, mass = np.zeros((26, 26)), np.zeros(26)
    for nodes, first in ((blade, 0), (flanks, 14)):
        for i in range(len(nodes)):
            for j in range(i):
                axis = (nodes[i] - nodes[j]) / np.linalg.norm(nodes[i] - nodes[j])
                row = np.zeros(26)
                row[first + 2 * i : first + 2 * i + 2], row[first + 2 * j : first + 2 * j + 2] = axis, -axis
                stiffness += rng.uniform(1e7, 3e7) * np.outer(row, row)
    stiffness[14:, 14:] += np.diag(rng.uniform(2e7, 4e7, 12))
    mass[:12], mass[12:14], mass[14:] = 0.01, 0.25, np.repeat(rng.uniform(0.01, 0.02, 6), 2)
    turn = np.radians(90.0 - angle + rng.uniform(-4.0, 4.0, 6))
    outward = np.column_stack([np.repeat([1.0, -1.0], 3) * np.cos(turn), np.sin(turn)])
    tangent = np.column_stack([-outward[:, 1], outward[:, 0]])
    normal, tangential = np.zeros((6, 26)), np.zeros((6, 26))
    for k in range(6):
        normal[k, 2 * k : 2 * k + 2], normal[k, 14 + 2 * k : 16 + 2 * k] = -outward[k], outward[k]
        tangential[k, 2 * k : 2 * k + 2], tangential[k, 14 + 2 * k : 16 + 2 * k] = tangent[k], -tangent[k]
    static, harmonic, tip = np.zeros(26), np.zeros(26), np.zeros(26)
    static[13], harmonic[12], harmonic[13], tip[12] = pull, excitation, 0.3 * excitation, 1.0
    return ReducedModel(
        mass=np.diag(mass),
        damping=damping * stiffness + 5.0 * np.diag(mass),
        stiffness=stiffness,
        normal=normal,
        tangential=tangential,
        load={0: static, 1: harmonic},
        pair_area=rng.uniform(1e-5, 2e-5, 6),
        outputs={"tip": tip},
    )


def random_structure(*, size: int = 9, pairs: int = 3, tangents: int = 1, seed: int = 0) -> ReducedModel:
    """A grounded structure with no meaning at all: random positive matrices, random rows, no load."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(2, size, size))
    mass, stiffness = (r @ r.T / size + np.eye(size) for r in root)
    return ReducedModel(
        mass=mass,
        damping=0.05 * stiffness + 0.05 * mass,
        stiffness=stiffness,
        normal=rng.normal(size=(pairs, size)),
        tangential=rng.normal(size=(pairs * tangents, size)) if tangents else None,
        outputs={"tip": rng.normal(size=size)},
    )


def bar_against_wall(*, elements: int, mean: float, amplitude: float) -> ReducedModel:
    """A bar with ``E = A = rho = L = 1``, pressed on a wall by a force at its far end, where a dashpot absorbs waves.

    The dashpot has the bar's impedance 1: nothing that comes back from the wall is reflected. The bar floats.
    """
    h, n = 1.0 / elements, elements + 1
    stiffness, mass, damping = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    for e in range(elements):
        stiffness[e : e + 2, e : e + 2] += np.array([[1.0, -1.0], [-1.0, 1.0]]) / h
        mass[e : e + 2, e : e + 2] += np.array([[2.0, 1.0], [1.0, 2.0]]) * h / 6
    damping[0, 0] = 1.0
    far, wall = np.eye(n)[0], np.eye(n)[-1]
    return ReducedModel(
        mass=mass,
        damping=damping,
        stiffness=stiffness,
        normal=[-wall],
        load={0: mean * far, 1: amplitude * far},
        outputs={"contact_end": wall},
    )


def transform_coordinates(model: ReducedModel, basis: np.ndarray) -> ReducedModel:
    """The same structure in other coordinates: ``x = basis @ y``, any regular ``basis``."""
    symmetric = lambda matrix: 0.5 * (matrix + matrix.T)  # noqa: E731
    return replace(
        model,
        mass=symmetric(basis.T @ model.mass @ basis),
        damping=basis.T @ model.damping @ basis,
        stiffness=symmetric(basis.T @ model.stiffness @ basis),
        normal=None if model.normal is None else model.normal @ basis,
        tangential=None if model.tangential is None else model.tangential @ basis,
        load={h: basis.T @ f for h, f in model.load.items()},
        rigid_modes=None,
        outputs={name: row @ basis for name, row in model.outputs.items()},
    )


def stop_oscillator(
    *,
    excitation: complex = 0.08,
    damping: float = 0.04,
    stiffness: float = 1.0,
    stop_stiffness: float = 1.0,
    load: Mapping[int, complex] | None = None,
) -> ReducedModel:
    """One mass on a spring that meets a springy stop: the stop's massless end touches a wall across an initial gap.

    ``x'' + damping x' + stiffness x + stop_stiffness max(0, x - gap) = excitation cos``, or another ``load``, harmonic
    -> amplitude: as the gap closes the resonance bends to higher frequencies and its curve folds.
    """
    k, load = stop_stiffness, {1: excitation} if load is None else load
    return ReducedModel(
        mass=np.diag([1.0, 0.0]),
        damping=np.diag([damping, 0.0]),
        stiffness=[[stiffness + k, -k], [-k, k]],
        normal=[[0.0, -1.0]],
        load={h: [amplitude, 0.0] for h, amplitude in load.items()},
        outputs={"tip": [1.0, 0.0]},
    )


def winkler_punch(
    *,
    load: float = 200.0,
    swing: float = 5e-6,
    stiffness: float = 1e12,
    pairs: int = 5,
    area: float = 2e-5,
    frequency: float = 100.0,
) -> ReducedModel:
    """A rigid punch, pressed on a Winkler foundation by ``load`` [N] and swung along it: its pressure is known exactly.

    Coordinates: the punch's motion along and across, then the foundation's surface at each pair. At ``frequency`` [Hz]
    the punch swings by ``swing`` [m]. ``stiffness`` is the foundation's, in pressure per depth [Pa/m].
    """
    springs = np.full(pairs, stiffness * area)
    rows = np.hstack([np.zeros((pairs, 1)), np.ones((pairs, 1)), -np.eye(pairs)])
    return ReducedModel(
        mass=np.diag([1.0, 1.0, *np.zeros(pairs)]),
        damping=np.zeros((pairs + 2,) * 2),
        stiffness=np.diag([1e6, 0.0, *springs]),
        normal=rows,
        tangential=np.eye(pairs + 2)[[0] * pairs],
        load={
            0: [0.0, -load, *np.zeros(pairs)],
            1: [swing * (1e6 - (2 * np.pi * frequency) ** 2), *np.zeros(pairs + 1)],
        },
        pair_area=np.full(pairs, area),
        outputs={"tip": np.eye(pairs + 2)[0]},
    )


def sled_in_a_plane(
    load: dict[int, object], damping: float = 0.1, stiffness: tuple[float, float] = (1.0, 1.0)
) -> ReducedModel:
    """A mass on springs in a plane, rubbing in both directions."""
    return ReducedModel(
        mass=np.eye(2),
        damping=damping * np.eye(2),
        stiffness=np.diag(stiffness),
        normal=np.zeros((1, 2)),
        tangential=np.eye(2),
        load=load,
        outputs={"x": [1.0, 0.0], "y": [0.0, 1.0]},
    )


def foot_on_the_ground(excitation: complex = 2.0) -> ReducedModel:
    """A mass on an oblique spring; its massless foot is pressed on the ground, rubs in a plane and lifts off.

    Coordinates ``(x, y, z)`` of the mass, then of the foot.
    """
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    spring = turn @ np.diag([0.8, 1.0, 1.4]) @ turn.T
    stiffness = np.block([[spring, -spring], [-spring, spring]]) + np.diag([1.0, 1.2, 1.5, 0.1, 0.15, 0.2])
    mass, each = np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]), np.eye(6)
    return ReducedModel(
        mass=mass,
        damping=0.03 * (stiffness + mass),
        stiffness=stiffness,
        normal=each[5:],
        tangential=each[3:5],
        load={0: -each[5], 1: excitation * np.array([0.8, 0.4j, 0.5j, 0.0, 0.0, 0.0])},
        outputs={"x": each[0], "y": each[1], "z": each[2]},
    )


def block_on_feet(load: dict[int, object], slope: float = 0.0) -> ReducedModel:
    """A rigid block that floats in space, with six massless feet on springs: only contact holds it.

    On a plane (``slope = 0``) it takes friction to hold the block; in three V-grooves, whose flanks have a ``slope``
    [degrees], it does not. Coordinates: the block's motion ``(x, y, z)`` and its turn about each axis, then
    ``(x, y, z)`` of each foot. ``load`` acts on the block, ``(6,)`` a harmonic.
    """
    rng, each = np.random.default_rng(4), np.eye(24)
    stiffness, normal, tangential = np.zeros((24, 24)), [], []
    for k in range(6):
        at = 2 * np.pi * (k // 2 / 3 + k % 2 / 20)
        x, y, z = np.cos(at), np.sin(at), -0.4
        ride = np.array([[1, 0, 0, 0, z, -y], [0, 1, 0, -z, 0, x], [0, 0, 1, y, -x, 0]])
        foot = each[6 + 3 * k : 9 + 3 * k]
        stretch = ride @ each[:6] - foot
        stiffness += stretch.T @ np.diag(rng.uniform(30.0, 60.0, 3)) @ stretch
        lean = np.radians(slope) * (-1) ** k
        outward, around = np.array([x, y, 0.0]), np.array([-y, x, 0.0])
        inward = np.cos(lean) * np.array([0.0, 0.0, 1.0]) + np.sin(lean) * around
        normal.append(inward @ foot)
        tangential += [outward @ foot, np.cross(inward, outward) @ foot]
    mass = np.diag([1.0, 1.0, 1.0, 0.3, 0.35, 0.5, *np.zeros(18)])
    return ReducedModel(
        mass=mass,
        damping=0.02 * mass + 0.01 * stiffness,
        stiffness=stiffness,
        normal=normal,
        tangential=tangential,
        load={h: np.concatenate([np.asarray(f), np.zeros(18)]) for h, f in load.items()},
        outputs={"x": each[0], "y": each[1], "turn": each[5]},
    )


def one_pressed_of_two() -> ReducedModel:
    """Two masses in a row, along and across: the first is pressed on its pair, the second shaken beside its own."""
    stiffness = 2.0 * np.eye(4) - 0.5 * (np.eye(4, k=1) + np.eye(4, k=-1))
    return ReducedModel(
        mass=np.eye(4),
        damping=0.05 * stiffness,
        stiffness=stiffness,
        normal=np.eye(4)[1::2],
        tangential=np.eye(4)[::2],
        load={0: [0.0, -5.0, 0.0, 0.0], 1: [0.0, 0.0, 1.0, 0.3]},
    )


# Each kind of contact once, with what makes it special
PROBLEMS = {
    "floating, slip": ContactProblem(dovetail(), ContactLaws(friction=0.2), 481.0, 5),
    "floating, mean zero": ContactProblem(dovetail(), ContactLaws(friction=0.3, static_friction="zero"), 200.0, 3),
    "lift-off": ContactProblem(lift_off_oscillator(excitation=4.0), ContactLaws(friction=0.3), 0.2, 9),
    "stuck": ContactProblem(lift_off_oscillator(excitation=0.01), ContactLaws(friction=0.6), 0.1, 3),
    "prescribed": ContactProblem(
        friction_oscillator(damping=0.05),
        ContactLaws("prescribed", normal_force={0: 0.4, 1: 0.1j}, friction=1.0),
        0.1,
        7,
    ),
    "plane, floating": ContactProblem(
        block_on_feet({0: [0.0, 0.0, -3.0, 0.0, 0.0, 0.0], 1: [1.2, 0.8j, 0.2, 0.0, 0.0, 0.3]}, slope=40.0),
        ContactLaws(friction=0.2),
        0.6,
        5,
    ),
    "plane, lift-off": ContactProblem(foot_on_the_ground(), ContactLaws(friction=0.3), 0.2, 5),
}
