"""Do the cases that found no solution have a periodic motion at all?

    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/hard_cases.py --cases 108 --seed SEED --cap 300
    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/failures_in_time.py      reads its JSON; a few minutes

Each failure of the sample that `hard_cases.py` draws of all its models is stepped in time from the full-stick motion,
at two step sizes. A motion that still changes from period to period after hundreds of periods, by a good part of itself
and at both step sizes, has no stable periodic state for the harmonic solver to find; there may be unstable ones.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from hard_cases import MODELS, draw_cases, pose_case
from reporting import RESULTS, describe_machine, print_table, write_json

from ewr_fenicsx import integrate
from ewr_fenicsx.solver.newton import APERIODIC

STEPS, PERIODS, TOLERANCE = (800, 1600), 300, 1e-3
THETA = 0.55  # damps the nodes of little mass, whose ringing 1/2 keeps alive: that must not pass for physics
LAST = 50  # periods at the end, over which the median counts: an aperiodic motion comes close to itself by chance
HEADER = ["case", "solver", *(f"{steps} steps: change a period" for steps in STEPS), "motion"]


def watch_motion(problem, steps: int) -> float:
    """Median change from one of the last periods to the next, relative; infinite where the motion runs away."""
    steady = integrate(problem, steps=steps, periods=PERIODS, tolerance=TOLERANCE, theta=THETA)
    return float(steady.changes[-1] if steady.converged else np.median(steady.changes[-LAST:]))


def judge_motion(changes: list[float]) -> str:
    """What the two step sizes say together."""
    if max(changes) <= TOLERANCE:
        return "periodic"
    return "aperiodic" if min(changes) > APERIODIC else "not settled"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", type=Path, default=RESULTS / "hard_cases.json", help="JSON of hard_cases.py")
    parser.add_argument("--output", type=Path, help="JSON file [benchmarks/results/failures_in_time.json]")
    arguments = parser.parse_args()
    machine, content = describe_machine(), json.loads(arguments.source.read_text())
    count = next(row[1] for row in content["tables"]["model"] if row[0] == next(iter(MODELS)))
    cases = [c for i, name in enumerate(MODELS) for c in draw_cases(name, count, content["seed"] + i)]
    rows = []
    for failure in content["failures"]:
        for case in (c for c in cases if c.name == failure["name"]):
            problem = pose_case(case)
            changes = [watch_motion(problem, steps) for steps in STEPS]
            rows.append([case.name, failure["status"], *changes, judge_motion(changes)])
            print(*rows[-1], sep="; ", flush=True)
    print_table("Failures, stepped in time", HEADER, rows)
    found = {kind: sum(row[-1] == kind for row in rows) for kind in ("periodic", "aperiodic", "not settled")}
    print("\n" + ", ".join(f"{n} {kind}" for kind, n in found.items()))
    write_json(
        "failures_in_time", {"machine": machine, "header": HEADER, "rows": rows, "motions": found}, arguments.output
    )


if __name__ == "__main__":
    main()
