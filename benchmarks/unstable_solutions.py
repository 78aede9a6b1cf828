"""Do motions in time leave the solutions that are called unstable, and no others? Hard cases, stepped from there.

    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/unstable_solutions.py                  ten minutes

Cases: the sample of `hard_cases.py` with default weights, from five harmonics on, where some pair slips or lifts off;
and as many of two blocks from a mesh, of which one jumps.
Each solution is stepped for 100 periods from itself. A motion has left when its last periods
are no repetition, or when the rms of an output is off by more than a tenth, which few harmonics may do as well.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from hard_cases import MODELS, CapReached, draw_cases, limit_work, pose_case
from models import two_blocks
from reporting import describe_machine, print_table, write_json

from ewr_fenicsx import integrate, solve
from ewr_fenicsx.errors import NotConverged

MODELS |= {"two blocks": two_blocks}
LEAST, STEPS, PERIODS, THETA = 5, 400, 100, 0.52
LEFT, REPEATS = 0.1, 0.03  # relative change of an output's rms; change from period to period


def find_fate(solution) -> tuple[str, float]:
    """Where a motion that begins on a solution is after many periods, and how far the outputs' rms is off."""
    steady = integrate(solution.problem, solution, STEPS, PERIODS, tolerance=0, theta=THETA)
    off = []
    for name in solution.problem.model.outputs:
        here = np.linalg.norm(solution.output(name)[1:]) / np.sqrt(2)
        off.append(abs(steady.output_history(name).std() / here - 1))
    if np.median(steady.changes[-10:]) > REPEATS:
        return "no repetition", max(off)
    return ("settled elsewhere" if max(off) > LEFT else "stays"), max(off)


def say(solution) -> str:
    """What the solution says of itself."""
    if solution.alternates:
        return "alternates"
    if solution.grows:
        return "beyond a fold"
    return "multiplier" if solution.multiplier else "nothing"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=108, help="cases a model [108]")
    parser.add_argument("--seed", type=int, default=101, help="of the sample [101]")
    parser.add_argument("--cap", type=float, default=15.0, help="processor seconds for a solve [15]")
    parser.add_argument("--output", type=Path, help="JSON file [benchmarks/results/unstable_solutions.json]")
    arguments = parser.parse_args()
    machine, counts, surprises = describe_machine(), Counter(), []
    for i, model in enumerate(MODELS):
        for case in draw_cases(model, arguments.cases, arguments.seed + i):
            if case.harmonics < LEAST:
                continue
            try:
                with limit_work(arguments.cap):
                    solution = solve(pose_case(replace(case, rho=(1, 1))))
            except (CapReached, NotConverged):
                counts[model, "no solution", "-"] += 1
                continue
            if not max(solution.merit["J_T"], solution.merit["J_N"]):
                continue  # linear: it sticks throughout
            said, (fate, off) = say(solution), find_fate(solution)
            counts[model, said, fate] += 1
            if (said == "nothing") != (fate == "stays"):
                surprises.append([case.name.rpartition(", rho")[0], said, fate, 100 * off, solution.merit["tension"]])
    rows = [[*key, count] for key, count in sorted(counts.items())]
    print_table(f"After {PERIODS} periods", ["model", "the solution says", "motion", "cases"], rows)
    header = ["case", "the solution says", "motion", "rms off by %", "tension N"]
    print_table("Where the two do not go together", header, surprises)
    content = {"machine": machine, "seed": arguments.seed, "counts": rows, "header": header, "surprises": surprises}
    write_json("unstable_solutions", content, arguments.output)


if __name__ == "__main__":
    main()
