"""Does worn volume depend on the number of contact pairs? 10, 20 and 40 a flank of the blade root.

    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/wear_pairs.py [--cycles 1000] [--output FILE]

Wear follows pressure, so that it converges with the pairs; by nodal force it would halve as they double.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from models import blade_root
from reporting import clock, describe_machine, print_table, write_json

from ewr_fenicsx import ContactLaws, ContactProblem, Tolerance, evolve_wear

PAIRS = (10, 20, 40)
FRICTION, FREQUENCY, COEFFICIENT = 0.2, 1050.0, 1e-11  # Hz, 1/Pa


def measure_volumes(cycles: int, pairs=PAIRS) -> list[dict]:
    """Worn volume [mm³] and the integral of the wear law over all pairs, for each number of pairs a flank."""
    rows = []
    for count in pairs:
        problem = ContactProblem(blade_root(count), ContactLaws(friction=FRICTION), FREQUENCY)
        history, seconds = clock(lambda: evolve_wear(problem, cycles, COEFFICIENT, Tolerance(share=0.005)))  # noqa: B023
        first = history.solutions[0]
        pressed, slid = first.press_and_slide(4096)
        integral = COEFFICIENT / FREQUENCY * float(np.mean(pressed * slid, axis=0).sum())
        rows.append(
            {
                "pairs": count,
                "volume": 1e9 * history.total_volume[-1],
                "first_cycle": 1e9 * float(history.rate[0] @ problem.model.pair_area),
                "integral": 1e9 * integral,
                "nodal": float(np.mean(pressed * slid, axis=0).mean()),
                "deepest": 1e6 * history.depth[-1].max(),
                "solves": history.solves,
                "seconds": seconds,
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cycles", type=int, default=1000)
    parser.add_argument("--output", type=Path, help="JSON file [benchmarks/results/wear_pairs.json]")
    arguments = parser.parse_args()
    machine = describe_machine()
    rows = measure_volumes(arguments.cycles)
    header = ["pairs a flank", "volume mm3", "of 40", "first cycle mm3", "integral mm3", "deepest um", "solves", "s"]
    last = rows[-1]["volume"]
    table = [
        [
            r["pairs"],
            round(r["volume"], 5),
            f"{r['volume'] / last - 1:+.2%}",
            r["first_cycle"],
            r["integral"],
            r["deepest"],
            r["solves"],
            r["seconds"],
        ]
        for r in rows
    ]
    print_table(
        f"wear of the blade root, {arguments.cycles} cycles at {FREQUENCY:g} Hz, mu = {FRICTION:g}", header, table
    )
    write_json("wear_pairs", {"machine": machine, "cycles": arguments.cycles, "rows": rows}, arguments.output)


if __name__ == "__main__":
    main()
