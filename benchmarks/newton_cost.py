"""What a contact solve costs, in units of one dense solve of its whole Jacobian.

The demo's blade root (40 pairs) at N = 5 and 15, over frequencies from 500 to 1500 Hz: the time of a cold solve, and of
one started from the solution 1 % below in frequency, over the time of one ``numpy.linalg.solve`` with the Jacobian
at the solution: ``(2N+1) x 2K_c`` unknowns and the rigid coordinates. Same process, same threads.

The demo's load leaves the joint stuck far from its resonance, where a solve takes no Newton step: medians over the
frequencies at which something slips or opens are given beside those over all, and a heavier load can be asked for.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np
from models import blade_root
from reporting import describe_machine, print_table, write_json

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.laws.coulomb import Coulomb
from ewr_fenicsx.laws.unilateral import Signorini

TARGETS = {5: {"warm": 2.0, "cold": 8.0}, 15: {"warm": 0.5, "cold": 4.0}}


def measure_best(run, repeats: int) -> tuple[float, object]:
    """Shortest wall time of some runs, and the last result: others on the machine only ever add time."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        result = run()
        times.append(time.perf_counter() - begin)
    return min(times), result


def measure_frequency(model: ReducedModel, frequency: float, harmonics: int, friction: float, repeats: int) -> dict:
    """Times of a cold, a warm and a dense solve at one frequency [s]; all but the model's modes is built anew."""
    pose = lambda f: ContactProblem(model, ContactLaws(friction=friction), f, harmonics)  # noqa: E731
    neighbour = solve(pose(0.99 * frequency), raise_on_failure=False)
    cold_time, cold = measure_best(lambda: solve(pose(frequency), raise_on_failure=False), repeats)
    warm_time, warm = measure_best(lambda: solve(pose(frequency), start=neighbour, raise_on_failure=False), repeats)
    compose_time, _ = measure_best(lambda: pose(frequency).system, repeats)
    balance = HarmonicBalance(cold.problem.system)
    step = balance.linearise(balance.pack(cold.forces, cold.rigid))
    matrix, steady = step.matrix(), float(np.mean(step.steady))
    dense_time, _ = measure_best(lambda: np.linalg.solve(matrix, step.residual), repeats)
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


class Stopwatch:
    """Time spent inside some of the package's functions, without what they pass on to each other."""

    def __init__(self):
        self.seconds, self.calls, self._open, self._undo = defaultdict(float), defaultdict(int), [], []

    def watch(self, owner: object, name: str, label: str) -> None:
        """Time a function or method from now on."""
        kept = owner.__dict__[name] if isinstance(owner, type) else getattr(owner, name)
        bound = isinstance(kept, (classmethod, staticmethod))
        inner = kept.__func__ if bound else kept

        def timed(*arguments, **options):
            begin = time.perf_counter()
            self._open.append(0.0)
            try:
                return inner(*arguments, **options)
            finally:
                spent = time.perf_counter() - begin
                self.seconds[label] += spent - self._open.pop()
                self.calls[label] += 1
                if self._open:
                    self._open[-1] += spent

        setattr(owner, name, type(kept)(timed) if bound else timed)
        self._undo.append((owner, name, kept))

    def stop(self) -> None:
        """Put every function back."""
        while self._undo:
            owner, name, kept = self._undo.pop()
            setattr(owner, name, kept)


def break_down(model: ReducedModel, frequencies: list[float], harmonics: int, friction: float) -> list[dict]:
    """Where the time of cold solves goes: seconds and calls by part, largest first."""
    import ewr_fenicsx.balance.newton_step as step_module
    import ewr_fenicsx.problem.contact_problem as problem_module
    import ewr_fenicsx.solver.ladder as ladder_module
    import ewr_fenicsx.solver.newton as newton_module

    stopwatch = Stopwatch()
    parts = [
        (problem_module, "compose", "compose, less what follows"),
        (problem_module, "condense", "compliance of all harmonics"),
        (HarmonicBalance, "residual", "residual"),
        (HarmonicBalance, "sample", "synthesis of motions"),
        (HarmonicBalance, "linearise", "linearise"),
        (step_module, "project_derivatives", "derivatives projected on the harmonics"),
        (step_module.NewtonStep, "_assemble", "assembly of the mixed rows"),
        (step_module.NewtonStep, "multiply", "products with the Jacobian"),
        (step_module.Factorisation, "__init__", "factorisation, less what is listed"),
        (step_module.Factorisation, "solve", "solves with factors of earlier steps, less products"),
        (step_module.Elimination, "of", "elimination of steady rows"),
        (ladder_module, "run_newton", "SNES and line search, less what is listed"),
        (newton_module, "solve", "the rest of solve"),
    ]
    parts += [(law, "evaluate", f"law: {law.__name__}") for law in (Signorini, Coulomb)]
    for owner, name, label in parts:
        if hasattr(owner, name):  # a part that was renamed is counted in the one that calls it
            stopwatch.watch(owner, name, label)
    try:
        for frequency in frequencies:
            problem = ContactProblem(model, ContactLaws(friction=friction), frequency, harmonics)
            newton_module.solve(problem, raise_on_failure=False)
    finally:
        stopwatch.stop()
    whole = sum(stopwatch.seconds.values())
    return [
        {"part": label, "seconds": spent, "share": spent / whole, "calls": stopwatch.calls[label]}
        for label, spent in sorted(stopwatch.seconds.items(), key=lambda item: -item[1])
    ]


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
    model = blade_root()
    model = replace(model, load={h: f * (arguments.load if h else 1.0) for h, f in model.load.items()})
    begin = time.perf_counter()
    _ = ContactProblem(model, ContactLaws(friction=arguments.friction), 700.0, 1).system
    print(f"once a model, not counted below: its modes and rows, {time.perf_counter() - begin:.3f} s")
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
    parts = {n: break_down(model, frequencies, n, arguments.friction) for n in arguments.harmonics}
    for n, rows in parts.items():
        print_table(
            f"Where the time of the cold solves goes, N = {n}",
            ["part", "s", "share", "calls", "ms a call"],
            [[r["part"], r["seconds"], r["share"], r["calls"], 1e3 * r["seconds"] / r["calls"]] for r in rows],
        )
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
            "breakdown": parts,
        },
        arguments.output,
    )


if __name__ == "__main__":
    main()
