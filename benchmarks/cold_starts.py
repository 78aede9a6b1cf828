"""What operator splitting buys a cold start: Newton steps and time with and without it, on the blade root.

    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/cold_starts.py                   some ten minutes
    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/cold_starts.py --harmonics 5 9

Frequencies across the resonance, from little friction to much, gentle to where pairs lift off; then with more and more
pairs. The first way of a cold start only, no fallbacks. Both ways in turn, in one process; times are its own (CPU),
without composing the problem. "Apart" is the largest difference of the tip's first harmonic between the two ways'
solutions; "iterations a step" how many iterations take as long as a Newton step with no row eliminated.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from statistics import median
from unittest.mock import patch

from models import blade_root, shake, take_step
from reporting import clock, describe_machine, print_table, write_json

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solver import ladder
from ewr_fenicsx.solver.splitting import Splitting

FREQUENCIES = (700.0, 850.0, 950.0, 1000.0, 1050.0, 1100.0, 1200.0, 1400.0)  # Hz
STATES = ((0.2, 1.0), (0.05, 1.0), (0.4, 2.0))  # friction, load over the demo's
ORDERS, CLOSURES = (5, 9, 15, 31), ("dashpot", "spring")
PAIRS, FEWER_FREQUENCIES = (20, 40, 80), (900.0, 1000.0, 1100.0)  # a flank, with dashpots, N = 5 and the first state
HEADER = [
    "pairs",
    "closure",
    "N",
    "unknowns",
    "problems",
    "converged split",
    "climbing",
    "steps split",
    "climbing",
    "s split",
]
HEADER += ["climbing", "time ratio, median", "apart, %", "iterations a step"]


@contextmanager
def climbing() -> Iterator[None]:
    """Cold starts without a splitting while it is open."""
    with patch.object(ladder, "can_split", lambda _: False):
        yield


def start(problem: ContactProblem) -> tuple[PeriodicSolution, float]:
    """A cold solve by the first way, and the processor time that it took [s]."""
    _ = problem.system
    return clock(lambda: solve(problem, fallbacks=False, raise_on_failure=False))


def compare_iteration(problem: ContactProblem) -> float:
    """Iterations of a splitting that take as long as a Newton step, at full stick."""
    balance = HarmonicBalance(problem.system)
    splitting, unknowns = Splitting(balance), balance.pack(*balance.full_stick)
    state = splitting.begin()

    newton = clock(partial(take_step, balance, unknowns, all_rows=True), 2)[1]
    return newton / (clock(lambda: [splitting.compare(state) for _ in range(100)])[1] / 100)


def compare(
    demo: ReducedModel,
    closure: str,
    harmonics: int,
    frequencies: Sequence[float] = FREQUENCIES,
    states: Sequence[tuple[float, float]] = STATES,
) -> list[object]:
    """A row of the table."""
    runs, apart = [], 0.0
    for frequency in frequencies:
        for friction, weight in states:
            laws = ContactLaws(friction=friction)
            pose = partial(ContactProblem, shake(demo, weight), laws, frequency, harmonics, closure=closure)
            split = start(pose())
            with climbing():
                climbed = start(pose())
            runs.append((split, climbed))
            if split[0].converged and climbed[0].converged:
                tips = [solution.output("tip")[1] for solution, _ in (split, climbed)]
                apart = max(apart, abs(tips[0] / tips[1] - 1))
    both = [run for run in runs if all(solution.converged for solution, _ in run)]
    count = lambda way: sum(run[way][0].converged for run in runs)  # noqa: E731
    steps = lambda way: sum(run[way][0].iterations for run in both) / len(both)  # noqa: E731
    seconds = lambda way: sum(run[way][1] for run in both)  # noqa: E731
    ratios = [climbed[1] / split[1] for split, climbed in both if split[0].iterations]
    row = [demo.pairs, closure, harmonics, runs[0][0][0].unknowns, len(runs), count(0), count(1), steps(0), steps(1)]
    return [*row, seconds(0), seconds(1), median(ratios), 100 * apart, compare_iteration(pose())]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--harmonics", type=int, nargs="+", default=list(ORDERS), metavar="N", help="[5 9 15 31]")
    parser.add_argument("--output", type=Path, help="JSON file [benchmarks/results/cold_starts.json]")
    arguments = parser.parse_args()
    machine = describe_machine()
    start(ContactProblem(blade_root(), ContactLaws(friction=0.2), 1000.0, 3))  # modes found, modules loaded
    rows = [compare(blade_root(), closure, n) for closure in CLOSURES for n in arguments.harmonics]
    rows += [compare(blade_root(pairs), "dashpot", 5, FEWER_FREQUENCIES, STATES[:1]) for pairs in PAIRS]
    print_table("Cold starts with a splitting, and climbing through sets of harmonics", HEADER, rows)
    write_json("cold_starts", {"machine": machine, "header": HEADER, "rows": rows}, arguments.output)


if __name__ == "__main__":
    main()
