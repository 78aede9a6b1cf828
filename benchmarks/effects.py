"""What each effect costs: unknowns, stages run and time, against the fullest formulation with the effect made inert.

A lap joint of seven pairs (``models.lap_joint``), N = 5, under laws from fully bonded to friction and separation on
mixed flanks. Beside each scene stands the same physics written with more effects than it calls for: friction with
``mu = 0`` for frictionless, a preload of ten kilonewtons a pair for bonded, a gap of a metre for no contact, all
harmonics for those that symmetry leaves. Both must give the same result, with the same weights ``rho``: their defaults
follow the flexibility of the structure that the bonds leave. ``tests/verification/test_effects.py`` asserts unknowns,
stages and results; here are the times.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from statistics import median
from unittest.mock import patch

import numpy as np
from models import blade_root, lap_joint
from reporting import describe_machine, print_table, write_json

from ewr_fenicsx import ContactLaws, ContactProblem, PeriodicSolution, solve

PAIRS, N = 7, 5
EVERY = tuple(range(N + 1))  # a list: nothing is left out of it
ALL = 2 * N + 1  # real coefficients a row
ODD_AND_MEAN = 1 + 2 * 3
LEFT, RIGHT = [0, 1, 2], [3, 4, 5, 6]
HUGE = 1e4  # N; the shaker moves the contact forces by some 100 N

BONDED = ContactLaws("bonded", "bonded")
BONDED_HEAVY = ContactLaws("unilateral", "bonded")  # with a huge preload
SLIDING = ContactLaws("unilateral", "frictionless")
RUBBING = ContactLaws(friction=0.3)
NO_FRICTION = ContactLaws(friction=0.0)
ABSENT = ContactLaws("prescribed", "frictionless", normal_force=0.0)
FAR_APART = ContactLaws(friction=0.3, initial_gap=1.0)


build_joint = cache(lap_joint)  # its modes and rows are computed once, as in any series of solves


@cache
def choose_weights() -> dict[str, np.ndarray]:
    """The default weights of friction and separation at all pairs."""
    normal, tangential = ContactProblem(build_joint(pairs=PAIRS), RUBBING, 330.0, N).system.laws
    return {"rho_normal": normal.rho, "rho_tangential": tangential.rho}


def pose(laws, *, excitation: float = 15.0, frequency: float = 330.0, press: Sequence[int] = (), **other):
    """The lap joint under some laws; ``press``: pairs with a huge preload."""
    model = build_joint(pairs=PAIRS, preload=700.0, excitation=excitation)
    load = model.load | {0: model.load[0] - HUGE * model.normal[list(press)].sum(axis=0)}
    return ContactProblem(model, laws, frequency, **{"harmonics": N, "load": load} | choose_weights() | other)


def given(tangential: str, **other) -> ContactLaws:
    """A normal force of 80 N at every pair."""
    return ContactLaws("prescribed", tangential, normal_force=80.0, **other)


@dataclass(frozen=True)
class Case:
    """One scene, and the same physics in more effects than it calls for.

    Attributes:
        name: What the scene has.
        problem: Poses it.
        unknowns: Those of its solve, by formula.
        inert: What the other formulation has, made inert.
        full: Poses that one; None where the scene is the fullest itself.
        runs: Stages that run; the others of ``STAGES`` must not.
        first: Lowest harmonic that both formulations share.
    """

    name: str
    problem: Callable[[], ContactProblem]
    unknowns: int
    inert: str
    full: Callable[[], ContactProblem] | None
    runs: frozenset[str]
    first: int = 0


STAGES = ("SNES", "Signorini", "Coulomb", "Bond", "ladder")
NOTHING, OPENS = frozenset(), frozenset({"SNES", "Signorini", "ladder"})
RUBS, BOTH = frozenset({"SNES", "Coulomb", "ladder"}), OPENS | {"Coulomb"}
EVERYONE = tuple(range(PAIRS))

CASES = [
    Case("bonded", lambda: pose(BONDED, press=EVERYONE), 0,
         "separation under a huge preload", lambda: pose(BONDED_HEAVY, press=EVERYONE), NOTHING),
    Case("bonded normal, frictionless", lambda: pose(ContactLaws("bonded", "frictionless"), press=EVERYONE), 0,
         "separation under a huge preload", lambda: pose(SLIDING, press=EVERYONE), NOTHING),
    Case("prescribed, frictionless", lambda: pose(given("frictionless")), 0,
         "friction, mu = 0", lambda: pose(given("coulomb", friction=0.0), harmonics=EVERY), NOTHING),
    Case("prescribed, bonded", lambda: pose(given("bonded")), 0,
         "friction, mu = 1e6", lambda: pose(given("coulomb", friction=1e6), harmonics=EVERY), NOTHING, first=1),
    Case("prescribed, friction", lambda: pose(given("coulomb", friction=0.3)), PAIRS * ODD_AND_MEAN,
         "even harmonics", lambda: pose(given("coulomb", friction=0.3), harmonics=EVERY), RUBS),
    Case("prescribed, friction without mean", lambda: pose(given("coulomb", friction=0.3, static_friction="zero")),
         PAIRS * (ODD_AND_MEAN - 1),
         "mean friction", lambda: pose(given("coulomb", friction=0.3), harmonics=EVERY), RUBS),
    Case("separation, frictionless", lambda: pose(SLIDING), PAIRS * ALL,
         "friction, mu = 0", lambda: pose(NO_FRICTION), OPENS),
    Case("bonded normal, friction", lambda: pose(ContactLaws("bonded", friction=0.3), excitation=5.0, frequency=300.0),
         2 * PAIRS * ALL,
         "separation, pressed", lambda: pose(RUBBING, excitation=5.0, frequency=300.0), RUBS | {"Bond"}),
    Case("at rest", lambda: pose(RUBBING, excitation=0.0), 2 * PAIRS,
         "harmonics 1 to 5", lambda: pose(RUBBING, excitation=0.0, harmonics=EVERY), BOTH),
    Case("left absent, right both", lambda: pose([(LEFT, ABSENT), (RIGHT, RUBBING)]), 2 * len(RIGHT) * ALL,
         "a gap of 1 m on the left", lambda: pose([(LEFT, FAR_APART), (RIGHT, RUBBING)]), BOTH),
    Case("left bonded, right both", lambda: pose([(LEFT, BONDED), (RIGHT, RUBBING)], press=(0, 1, 2)),
         2 * len(RIGHT) * ALL, "separation under a huge preload on the left",
         lambda: pose([(LEFT, BONDED_HEAVY), (RIGHT, RUBBING)], press=(0, 1, 2)), BOTH),
    Case("left frictionless, right both", lambda: pose([(LEFT, SLIDING), (RIGHT, RUBBING)]),
         (len(LEFT) + 2 * len(RIGHT)) * ALL,
         "mu = 0 on the left", lambda: pose([(LEFT, NO_FRICTION), (RIGHT, RUBBING)]), BOTH),
    Case("four kinds of flank",
         lambda: pose([([0], BONDED), ([1, 2], SLIDING), ([3], ContactLaws(friction=0.6, initial_gap=1e-6)),
                       ([4, 5, 6], RUBBING)], press=(0,)),
         (2 + 2 + 2 * 3) * ALL, "a huge preload, mu = 0, and worn instead of open",
         lambda: pose([([0], BONDED_HEAVY), ([1, 2], NO_FRICTION), ([3], ContactLaws(friction=0.6)),
                       ([4, 5, 6], RUBBING)], press=(0,), wear=1e-6 * (np.arange(PAIRS) == 3)), BOTH),
    Case("separation and friction", lambda: pose(RUBBING), 2 * PAIRS * ALL, "", None, BOTH),
]  # fmt: skip


WEAR_CYCLES, WEAR = 5, 1e-9


def pose_wear() -> tuple[ContactProblem, np.ndarray]:
    """Friction, separation and wear on the right flank; the left one bonded, without wear."""
    return pose([(LEFT, BONDED), (RIGHT, RUBBING)], press=LEFT), WEAR * (np.arange(PAIRS) >= len(LEFT))


def pose_full_wear() -> tuple[ContactProblem, np.ndarray]:
    """The same with a left flank that could open and wear, but is pressed and cannot slip."""
    return pose([(LEFT, BONDED_HEAVY), (RIGHT, RUBBING)], press=LEFT), np.full(PAIRS, WEAR)


@contextmanager
def count_calls() -> Iterator[Counter]:
    """Counts SNES objects, law evaluations and cold starts while it is open."""
    import ewr_fenicsx.solver.newton as newton
    import ewr_fenicsx.solver.snes as snes
    from ewr_fenicsx.laws.bonded import Bond
    from ewr_fenicsx.laws.coulomb import Coulomb
    from ewr_fenicsx.laws.unilateral import Signorini

    counts: Counter = Counter()

    def counted(name: str, action: Callable) -> Callable:
        def call(*arguments, **options):
            counts[name] += 1
            return action(*arguments, **options)

        return call

    class CountedSNES(snes.PETSc.SNES):
        def create(self, *arguments, **options):
            counts["SNES"] += 1
            return super().create(*arguments, **options)

    with (
        patch.object(snes.PETSc, "SNES", CountedSNES),
        patch.object(newton, "start_cold", counted("ladder", newton.start_cold)),
        patch.object(Signorini, "evaluate", counted("Signorini", Signorini.evaluate)),
        patch.object(Coulomb, "evaluate", counted("Coulomb", Coulomb.evaluate)),
        patch.object(Bond, "evaluate", counted("Bond", Bond.evaluate)),
    ):
        yield counts


def compare(found: PeriodicSolution, full: PeriodicSolution, first: int = 0) -> float:
    """Largest difference of the motion and of the normal forces, relative to the largest of each."""
    difference = 0.0
    for ours, theirs in (
        (found.coordinates, full.coordinates),
        (found.pair_forces["normal"], full.pair_forces["normal"]),
    ):
        largest = np.abs(theirs[first:]).max()
        difference = max(difference, np.abs(ours - theirs)[first:].max() / largest if largest else 0.0)
    return float(difference)


def measure(posers: Sequence[Callable[[], ContactProblem]], repeats: int) -> list[tuple[PeriodicSolution, float]]:
    """Cold solves, and the median time of several of each [s], composition included; one of each in turn."""
    times: list[list[float]] = [[] for _ in posers]
    for _ in range(repeats + 1):  # the first one warms the caches
        solutions = []
        for own, pose_problem in zip(times, posers, strict=True):
            problem = pose_problem()
            begin = time.perf_counter()
            solutions.append(solve(problem, tolerance=1e-11))
            own.append(time.perf_counter() - begin)
    return [(solution, median(own[1:])) for solution, own in zip(solutions, times, strict=True)]


def measure_wear(posed: tuple[ContactProblem, np.ndarray], repeats: int):
    """A short wear history, and the median time of several [s]."""
    from ewr_fenicsx import evolve_wear

    times = []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        history = evolve_wear(posed[0], WEAR_CYCLES, posed[1], tolerance=1e-11)
        times.append(time.perf_counter() - begin)
    return history, median(times[1:])


def list_blade_root() -> list[tuple[str, ContactProblem, int]]:
    """Scenes on the demo's blade root, 40 pairs on four flanks, N = 9: name, problem and unknowns by formula."""
    model, coefficients, rigid = blade_root(), 19, 3
    flank = lambda k: np.arange(10 * k, 10 * (k + 1))  # noqa: E731
    rubs = ContactLaws(friction=0.2)
    laws = {
        "bonded": (BONDED, 0),
        "bonded normal, frictionless": (ContactLaws("bonded", "frictionless"), 0),
        "separation, stuck": (BONDED_HEAVY, 40 * coefficients),
        "one flank of four, the others bonded": (
            [(flank(0), rubs), (np.arange(10, 40), BONDED)],
            20 * coefficients,
        ),
        "two flanks of four, the others bonded": (
            [(np.arange(20), rubs), (np.arange(20, 40), BONDED)],
            40 * coefficients,
        ),
        "at rest": (rubs, 80 + rigid),
        "separation and friction": (rubs, 80 * coefficients + rigid),
    }
    pose = lambda name, of: ContactProblem(  # noqa: E731
        model, of, 1000.0, 9, load={0: model.load[0]} if name == "at rest" else None
    )
    return [(name, pose(name, of), unknowns) for name, (of, unknowns) in laws.items()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=9, help="runs of each solve, of which the median counts [9]")
    parser.add_argument("--output", type=Path, help="JSON file [benchmarks/results/effects.json]")
    arguments = parser.parse_args()
    machine = describe_machine()
    rows, records = [], []
    for case in CASES:
        posers = [case.problem] + ([case.full] if case.full else [])
        (solution, seconds), *fuller = measure(posers, arguments.repeats)
        record = {"scene": case.name, "unknowns": solution.unknowns, "formula": case.unknowns, "seconds": seconds}
        record |= {"steps": solution.iterations, "full_steps": None}
        record |= {"inert": case.inert or "(the fullest)", "full_unknowns": None, "ratio": None, "difference": None}
        for full, full_seconds in fuller:
            record |= {"full_unknowns": full.unknowns, "full_seconds": full_seconds, "ratio": seconds / full_seconds}
            record["full_steps"] = full.iterations
            record["difference"] = compare(solution, full, case.first)
        records.append(record)
        shown = ("scene", "unknowns", "steps", "inert", "full_unknowns", "full_steps", "difference")
        rows.append([*(record[key] for key in shown), 1e3 * seconds, record["ratio"]])
    (worn, seconds), (full, full_seconds) = (measure_wear(p(), arguments.repeats) for p in (pose_wear, pose_full_wear))
    record = {
        "scene": f"left bonded, right both and wear, {WEAR_CYCLES} cycles",
        "unknowns": worn.solutions[-1].unknowns,
        "steps": sum(solution.iterations for solution in worn.solutions),
        "inert": "a huge preload and wear on the left",
        "full_unknowns": full.solutions[-1].unknowns,
        "full_steps": sum(solution.iterations for solution in full.solutions),
        "difference": float(np.abs(worn.depth - full.depth).max() / full.depth.max()),
        "seconds": seconds,
        "full_seconds": full_seconds,
        "ratio": seconds / full_seconds,
    }
    records.append(record)
    rows.append([*(record[key] for key in shown), 1e3 * seconds, record["ratio"]])
    header = ["scene", "unknowns", "steps", "fullest formulation: inert", "unknowns", "steps"]
    header += ["difference", "ms", "time / fullest"]
    print_table("Scenes that say what they mean, against the same physics with inert effects", header, rows)
    blade, shown = [], []
    for name, problem, unknowns in list_blade_root():
        ((solution, seconds),) = measure([lambda problem=problem: replace(problem)], arguments.repeats)
        blade.append({"scene": name, "unknowns": solution.unknowns, "formula": unknowns, "seconds": seconds})
        shown.append([name, solution.unknowns, unknowns, solution.iterations, 1e3 * seconds])
    fullest = blade[-1]["seconds"]
    header = ["scene", "unknowns", "by formula", "steps", "ms", "time / fullest"]
    print_table("The blade root, N = 9", header, [[*row, row[-1] / 1e3 / fullest] for row in shown])
    write_json("effects", {"machine": machine, "cases": records, "blade_root": blade}, arguments.output)


if __name__ == "__main__":
    main()
