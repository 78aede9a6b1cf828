"""How the time and memory of a Newton step grow with the number of pairs and of harmonics.

The demo's blade root: K_c pairs at N = 5, and N harmonics at 40 pairs. A step is one linearisation and one solve, at
the state in which a cold start begins: the full-stick forces just below resonance, where a quarter of the rows changes
status within the period. "All rows" is the same step with no row eliminated: the worst that any state can cost. Memory
is what Python and numpy allocate at most during the step (LAPACK works in place). Exponents are fitted over the upper
half of each series.
"""

from __future__ import annotations

import argparse
import tracemalloc
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from models import blade_root, take_step
from reporting import clock, describe_machine, print_table, write_json

from ewr_fenicsx import ContactLaws, ContactProblem
from ewr_fenicsx.balance.balance import HarmonicBalance

FREQUENCY = 1060.0  # Hz; the first full-stick mode is at 1091


def measure_step(balance: HarmonicBalance, repeats: int, keep_all_rows: bool) -> tuple[float, float]:
    """Shortest time of one Newton step [s], and the memory that it takes on top [MB]."""
    start = balance.pack(*balance.full_stick)

    step = partial(take_step, balance, start, all_rows=keep_all_rows)
    _, seconds = clock(step, repeats)
    tracemalloc.start()
    step()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return seconds, peak / 1e6


def measure_size(pairs: int, harmonics: int, repeats: int, largest: int) -> dict:
    """One size: a problem posed, one step with steady rows eliminated, one without (up to ``largest`` unknowns)."""
    model = blade_root(pairs)
    pose = lambda: ContactProblem(model, ContactLaws(friction=0.2), FREQUENCY, harmonics)  # noqa: E731
    _ = pose().system  # the model's own modes and rows, once
    balance, composing = clock(lambda: HarmonicBalance(pose().system))
    mixed = float(np.mean(~balance.linearise(balance.pack(*balance.full_stick)).steady))
    seconds, memory = measure_step(balance, repeats, keep_all_rows=False)
    whole = measure_step(balance, max(1, repeats // 2), keep_all_rows=True) if balance.size <= largest else (None, None)
    return {
        "pairs": model.pairs,
        "harmonics": harmonics,
        "unknowns": balance.size,
        "mixed_rows": mixed,
        "compose_seconds": composing,
        "step_seconds": seconds,
        "step_megabytes": memory,
        "all_rows_seconds": whole[0],
        "all_rows_megabytes": whole[1],
    }


def fit_exponent(series: list[dict], size: Callable[[dict], float], key: str) -> float | None:
    """Exponent p of ``value ~ size^p`` over the upper half of a series."""
    points = [(size(m), m[key]) for m in series if m[key]]
    points = points[len(points) // 2 :]
    if len(points) < 2:
        return None
    return float(np.polyfit(*np.log(np.array(points).T), 1)[0])


KEYS = ("compose_seconds", "step_seconds", "step_megabytes", "all_rows_seconds", "all_rows_megabytes")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--pairs", type=int, nargs="+", default=[3, 5, 10, 20, 40, 80], help="pairs a flank, of four [3 5 10 20 40 80]"
    )
    parser.add_argument(
        "--harmonics", type=int, nargs="+", default=[1, 3, 5, 9, 15, 23, 31], metavar="N", help="[1 3 5 9 15 23 31]"
    )
    parser.add_argument("--repeats", type=int, default=3, help="runs of each step, of which the shortest counts [3]")
    parser.add_argument("--largest", type=int, default=5200, help="unknowns up to which all rows are tried [5200]")
    parser.add_argument("--output", type=Path, help="JSON file [benchmarks/results/scaling.json]")
    arguments = parser.parse_args()
    machine = describe_machine()
    series = {
        "pairs": [measure_size(p, 5, arguments.repeats, arguments.largest) for p in arguments.pairs],
        "harmonics": [measure_size(10, n, arguments.repeats, arguments.largest) for n in arguments.harmonics],
    }
    exponents = {
        name: {
            key: fit_exponent(measured, lambda m, name=name: m["pairs"] if name == "pairs" else m["harmonics"], key)
            for key in KEYS
        }
        for name, measured in series.items()
    }
    header = ["K_c", "N", "unknowns", "mixed", "compose s", "step s", "step MB", "all rows s", "all rows MB"]
    for name, measured in series.items():
        rows = [
            [m["pairs"], m["harmonics"], m["unknowns"], m["mixed_rows"], *(m[key] for key in KEYS)] for m in measured
        ]
        print_table(f"By {name}", header, rows)
        fitted = ", ".join(f"{key.replace('_', ' ')} {p:.2f}" for key, p in exponents[name].items() if p is not None)
        print(f"exponents in {'K_c' if name == 'pairs' else 'N'}: {fitted}")
    write_json("scaling", {"machine": machine, "series": series, "exponents": exponents}, arguments.output)


if __name__ == "__main__":
    main()
