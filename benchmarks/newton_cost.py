"""What a contact solve costs, in units of one dense solve of its whole Jacobian.

The demo's blade root (40 pairs) at N = 5 and 15, over frequencies from 500 to 1500 Hz: the time of a cold solve, and of
one started from the solution 1 % below in frequency, over the time of one ``numpy.linalg.solve`` with the Jacobian
at the solution: ``(2N+1) x 2K_c`` unknowns and the rigid coordinates. Same process, same threads; processor times.

The demo's load leaves the joint stuck far from its resonance, where a solve takes no Newton step: medians over the
frequencies at which something slips or opens are given beside those over all, and a heavier load can be asked for.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from statistics import median

import numpy as np
from models import blade_root, shake
from reporting import clock, describe_machine, print_table, write_json

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.balance.balance import HarmonicBalance

TARGETS = {5: {"warm": 2.0, "cold": 8.0}, 15: {"warm": 0.5, "cold": 4.0}}


def measure_frequency(model: ReducedModel, frequency: float, harmonics: int, friction: float, repeats: int) -> dict:
    """Times of a cold, a warm and a dense solve at one frequency [s]; all but the model's modes is built anew."""
    pose = lambda f: ContactProblem(model, ContactLaws(friction=friction), f, harmonics)  # noqa: E731
    neighbour = solve(pose(0.99 * frequency), raise_on_failure=False)
    cold, cold_time = clock(lambda: solve(pose(frequency), raise_on_failure=False), repeats)
    warm, warm_time = clock(lambda: solve(pose(frequency), start=neighbour, raise_on_failure=False), repeats)
    _, compose_time = clock(lambda: pose(frequency).system, repeats)
    balance = HarmonicBalance(cold.problem.system)
    step = balance.linearise(balance.pack(cold.forces, cold.rigid))
    matrix, steady = step.matrix(), float(np.mean(step.steady))
    _, dense_time = clock(lambda: np.linalg.solve(matrix, step.residual), repeats)
    return {
        "frequency": frequency,
        "harmonics": harmonics,
        "unknowns": balance.size,
        "steady_rows": steady,
        "dense_seconds": dense_time,
        "compose_seconds": compose_time,
        "cold_seconds": cold_time,
        "warm_seconds": warm_time,
        "cold_steps": cold.iterations,
        "warm_steps": warm.iterations,
        "cold_fallbacks": len(cold.fallbacks),
        "warm_fallbacks": len(warm.fallbacks),
        "converged": bool(cold.converged and warm.converged and neighbour.converged),
        "cold": cold_time / dense_time,
        "warm": warm_time / dense_time,
    }


def summarise(measured: list[dict]) -> list[list[object]]:
    """Medians by N, over all frequencies and over those where the contact state changes within the period."""
    rows = []
    for n in sorted({m["harmonics"] for m in measured}):
        for label, of_n in (
            ("all", [m for m in measured if m["harmonics"] == n]),
            ("those that slip or open", [m for m in measured if m["harmonics"] == n and m["steady_rows"] < 1]),
        ):
            if of_n:
                middle = [median(m[key] for m in of_n) for key in ("dense_seconds", "warm", "cold")]
                worst = [max(m[key] for m in of_n) for key in ("warm", "cold")]
                steps = [median(m[key] for m in of_n) for key in ("warm_steps", "cold_steps")]
                goal = TARGETS.get(n, {"warm": None, "cold": None})
                rows.append(
                    [
                        *(n, label, len(of_n), of_n[0]["unknowns"], 1e3 * middle[0]),
                        *(middle[1], goal["warm"], middle[2], goal["cold"], *worst, *steps),
                        sum(not m["converged"] for m in of_n),
                    ]
                )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--harmonics", type=int, nargs="+", default=[5, 15], metavar="N", help="highest harmonics [5 15]"
    )
    parser.add_argument("--frequencies", type=int, default=21, metavar="COUNT", help="points from 500 to 1500 Hz [21]")
    parser.add_argument("--load", type=float, default=1.0, help="shaking load over the demo's [1]")
    parser.add_argument("--friction", type=float, default=0.2, help="friction coefficient [0.2]")
    parser.add_argument(
        "--repeats", type=int, default=3, help="runs of each measurement, of which the shortest counts [3]"
    )
    parser.add_argument("--output", type=Path, help="JSON file [benchmarks/results/newton_cost.json]")
    arguments = parser.parse_args()
    machine = describe_machine()
    model = shake(blade_root(), arguments.load)
    _, once = clock(lambda: ContactProblem(model, ContactLaws(friction=arguments.friction), 700.0, 1).system)
    print(f"once a model, not counted below: its modes and rows, {once:.3f} s")
    frequencies = np.linspace(500.0, 1500.0, arguments.frequencies).tolist()
    measured = [
        measure_frequency(model, frequency, n, arguments.friction, arguments.repeats)
        for n in arguments.harmonics
        for frequency in frequencies
    ]
    keys = ("harmonics", "frequency", "steady_rows", "dense_seconds", "compose_seconds", "warm_seconds", "cold_seconds")
    keys += ("warm", "cold", "warm_steps", "cold_steps", "warm_fallbacks", "cold_fallbacks", "converged")
    header = ["N", "Hz", "steady", "dense s", "compose s", "warm s", "cold s", "warm", "cold", "w steps", "c steps"]
    header += ["w rungs", "c rungs", "converged"]
    print_table(
        "Each frequency: times, and times over one dense solve", header, [[m[key] for key in keys] for m in measured]
    )
    summary = summarise(measured)
    header = ["N", "frequencies", "count", "unknowns", "dense ms", "warm", "to reach", "cold", "to reach"]
    header += ["worst warm", "worst cold", "w steps", "c steps", "failed"]
    print_table("Medians, in units of one dense solve", header, summary)
    print(f"load average at the end: {describe_machine()['load_average'][0]}")
    write_json(
        "newton_cost",
        {
            "machine": machine,
            "load_factor": arguments.load,
            "friction": arguments.friction,
            "medians": [
                dict(zip([*header[:6], "warm target", "cold", "cold target", *header[9:]], row, strict=True))
                for row in summary
            ],
            "points": measured,
        },
        arguments.output,
    )


if __name__ == "__main__":
    main()
