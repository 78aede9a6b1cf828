"""Hard cases of rings of sectors, and whether motions in time leave the waves that are called perhaps unstable.

    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/rings.py                          some ten minutes

Cold starts of one sector for all, of the three rings of the gallery: a bladed disk (40 pairs in each sector), a ring
with a damper between all neighbours (16) and one with shrouds (8), which their interference presses. Cases are drawn as
in ``hard_cases.py``, with the default weights, and nothing is tuned by case. Frequencies are over the first mode with
the joint stuck, of the ring with shrouds with it open: stuck, its blades hardly move.

Then small rings of five sectors, with pairs inside a sector and between sectors: each solution is stepped in time, all
sectors from where the solution is. A motion has left the wave where sectors come to differ, and go on changing.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from functools import lru_cache
from itertools import product
from pathlib import Path

import numpy as np
from hard_cases import DIMENSIONS, HEADER, Case, Outcome, count_up, draw_levels, pose_on, run_case
from models import ROOT, damp, shake
from reporting import describe_machine, print_table, write_json

from ewr_fenicsx import (
    ContactLaws,
    ContactProblem,
    PeriodicSolution,
    ReducedModel,
    integrate,
    load_scene,
    solve,
    unroll_ring,
)
from ewr_fenicsx.in_time.ring_growth import leaves
from ewr_fenicsx.in_time.time_stepping import State
from ewr_fenicsx.model.receptance import find_undamped_modes
from ewr_fenicsx.structure.chain import build_chain, pose_problem

sys.path[:0] = [str(ROOT / "tests" / part) for part in ("unit", "verification")]

from test_interference import start_elsewhere  # noqa: E402
from test_ring import ring, shroud  # noqa: E402

RINGS = ("bladed_disk", "damped_ring", "shrouded_ring")
LEVELS = {name: levels for name, levels in DIMENSIONS.items() if name not in ("harmonics", "rho")} | {
    "harmonics": (1, 3, 5, 9, 15)
}
SHAKEN, FREQUENCIES = (1.0, 1.5, 2.0, 3.0, 4.0), (40.0, 50.0, 60.0, 75.0, 90.0, 110.0)  # of small rings; and Hz
STEPS, PERIODS, THETA = 1024, 60, 0.505
LEFT = 0.03  # difference of sectors, and change a period, above which a motion has left


@lru_cache(maxsize=3)
def build(name: str) -> tuple[ReducedModel, float]:
    """The model of a sector, and the frequency that those of its cases are over [Hz]."""
    chain = build_chain(load_scene(ROOT / "demos" / f"{name}.toml"))
    problem, first = pose_problem(chain.scene, chain.reduction.model), float(chain.reduction.full_stick.frequency[0])
    if np.any(problem.clearance):  # as the mean load that presses by as much
        problem, _ = start_elsewhere(problem, np.zeros(problem.model.pairs))
        modes = find_undamped_modes(problem.model, problem.model.wave_of(1))
        first = float(1 / np.sqrt((modes.mass / modes.stiffness).max()) / (2 * np.pi))
    return problem.model, first


def pose(case: Case) -> ContactProblem:
    """The contact problem of a case."""
    model, first = build(case.model)
    return pose_on(damp(model, case.damping, first), first, case)


def step_all_sectors(solution: PeriodicSolution) -> tuple[float, float]:
    """Of the whole ring, begun on a sector's solution: how far sectors differ in the end, and still change a period."""
    problem = solution.problem
    cyclic, orders = problem.model.cyclic, np.array(solution.orders)[:, None]
    lag = 2 * np.pi * cyclic.engine_order / cyclic.sectors
    moved = np.hstack([solution.coordinates * np.exp(-1j * orders * lag * j) for j in range(cyclic.sectors)])
    whole = ContactProblem(unroll_ring(problem.model), problem.laws, problem.frequency, solution.orders[-1])
    stepped = integrate(whole, State.of(whole, moved), STEPS, PERIODS, tolerance=0, theta=THETA)
    tips = [np.linalg.norm(stepped.output(f"tip_{j}")[1:]) for j in range(cyclic.sectors)]
    return float(np.ptp(tips) / np.mean(tips)), float(stepped.changes[-1])


def count_fates(harmonics: int) -> Counter:
    """How many waves are told to be perhaps unstable, or not, and whether motions in time leave them."""
    counts = Counter()
    makes: tuple[Callable[[int], ReducedModel], ...] = (ring, shroud)
    for make, engine_order, shaken, frequency in product(makes, (1, 2), SHAKEN, FREQUENCIES):
        problem = ContactProblem(shake(make(engine_order), shaken), ContactLaws(friction=0.3), frequency, harmonics)
        solution = solve(problem, raise_on_failure=False)
        if solution.converged:
            gone = min(step_all_sectors(solution)) > LEFT
            counts["perhaps unstable" if leaves(solution.ring_growth) else "nothing", gone] += 1
    return counts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=36, help="a ring [36]")
    parser.add_argument("--seed", type=int, default=1, help="of the sample [1]")
    parser.add_argument("--cap", type=float, default=60.0, help="processor seconds for a case [60]")
    parser.add_argument("--output", type=Path, help="JSON file [benchmarks/results/rings.json]")
    arguments = parser.parse_args()
    machine = describe_machine()
    rows, everything = [], []
    for i, name in enumerate(RINGS):
        outcomes: list[Outcome] = []
        for levels in draw_levels(LEVELS, arguments.cases, arguments.seed + i):
            case = Case(name, **levels, rho=(1, 1))
            outcomes.append(run_case(case.name, lambda c=case: pose(c), arguments.cap))
        everything += outcomes
        rows.append([name.replace("_", " "), *count_up(outcomes)])
    rows.append(["all", *count_up(everything)])
    print_table("Rings of sectors, cold", ["ring", *HEADER], rows)
    failures = [o for o in everything if o.status != "converged"]
    for o in failures:
        print(f"  {o.status}: {o.name}\n      residual {o.residual}, {o.steps} steps, {o.seconds:.1f} s: {o.reason}")
    fates = []
    for harmonics in (5, 9, 15):
        counts = count_fates(harmonics)
        fates += [
            [harmonics, said, counts[said, True], counts[said, False]] for said in ("perhaps unstable", "nothing")
        ]
    told = ["harmonics", "the solution says", "motions leave", "motions stay"]
    print_table("Waves of small rings, and motions in time", told, fates)
    write_json(
        "rings",
        {
            "machine": machine, "seed": arguments.seed, "cap_seconds": arguments.cap, "header": ["ring", *HEADER],
            "rows": rows, "failures": [asdict(o) for o in failures], "fates_header": told, "fates": fates,
        },
        arguments.output,
    )  # fmt: skip


if __name__ == "__main__":
    main()
