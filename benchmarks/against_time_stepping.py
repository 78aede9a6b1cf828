"""Time to a given error: the harmonic solver from cold against time stepping, on the blade root.

    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/against_time_stepping.py      1000 and 1200 Hz: fifteen minutes

The harmonic solver with both closures of Coulomb's law (docs/method.md): dashpots and springs.

Near the resonance of the slipping joint (1000 Hz) and off it (1200 Hz). Errors are those of the tip: of the complex
amplitude of its first harmonic, of that amplitude's modulus, and of the rms of the oscillation, all relative, against
time stepping extrapolated to no step at all. The step from one extrapolation to the next finer one is the reference's
own error.

What counts is the fastest N, or number of steps, of those from which on all larger ones tried meet the level. Both may
stop early, as a level of 1 % needs no residual of 1e-8. The harmonic solver has three tolerances, of which the quickest
counts for which that holds; "to 1e-8" is its time with the default one. Time stepping is told by an oracle when to
stop: plain, at the first period from which on its error meets the level; accelerated, at the loosest tolerance tried
that meets it. A user has no such oracle and pays more: "own stop" is plain stepping until it finds itself steady, by
its default tolerance. One thread; compilation, and what is computed once a model, are not timed. Times are the
process's own (CPU), which other work on the machine disturbs less.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass
from itertools import pairwise, product
from pathlib import Path

import numpy as np
from models import blade_root
from reporting import clock, describe_machine, print_table, write_json

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate, solve
from ewr_fenicsx.solver.time_integration import SteadyState

FREQUENCIES, FRICTION = (1000.0, 1200.0), 0.2
LEVELS = (0.03, 0.01, 0.003, 0.001)
ORDERS = (*range(3, 16), 17, 19, 23, 27, 31, 39, 47, 63)
STEPS, PERIODS = (200, 400, 800, 1600), 100
TOLERANCES = (1e-2, 1e-3, 1e-4)  # of accelerated runs
USUAL = 1e-8  # tolerance of the harmonic solver, and looser ones
SOLVER_TOLERANCES = (USUAL, 1e-4, 1e-3)
REFERENCE_STEPS = (800, 1600, 3200, 6400)
TARGETS = {0.01: 20.0, 0.001: 1.0}  # level -> how many times faster the harmonic solver is to be
KINDS = ("complex", "modulus", "rms")
CLOSURES = ("dashpot", "spring")
STARTS = {"rest": "rest", "stick": None}
WAYS = tuple((name, start) for name in ("plain", "accelerated", "own stop") for start in STARTS)


@dataclass(frozen=True)
class Case:
    """What both solve: the blade root at an excitation frequency [Hz]."""

    model: ReducedModel
    frequency: float

    def pose(self, harmonics: int = 1, closure: str = "dashpot") -> ContactProblem:
        """A problem that shares nothing with those posed before, but what is computed once a model."""
        return ContactProblem(self.model, ContactLaws(friction=FRICTION), self.frequency, harmonics, closure=closure)


def measure_tip(steady: SteadyState) -> np.ndarray:
    """``(2,)`` complex first harmonic and rms of the oscillation [m], over the last period."""
    return np.array([steady.output("tip")[1], steady.output_history("tip").std()])


def compare(tip: np.ndarray, reference: np.ndarray) -> list[float]:
    """Relative errors, in the order of ``KINDS``."""
    return [
        float(abs(tip[0] - reference[0]) / abs(reference[0])),
        float(abs(abs(tip[0]) / abs(reference[0]) - 1)),
        float(abs(tip[1] / reference[1] - 1)),
    ]


def find_reference(case: Case) -> dict:
    """Steady tip motion without truncation or step error, and how far it moved with the last halving of the step."""
    start, tips, rows = None, [], []
    for steps in REFERENCE_STEPS:  # from few steps to many: the transient dies while steps are cheap
        steady = integrate(case.pose(), start, steps, periods=100, tolerance=2e-6, acceleration=True)
        start = steady.end
        tips.append(measure_tip(steady))
        rows.append([steps, steady.periods, "yes" if steady.converged else "no"])
    extrapolated = [fine + (fine - coarse) / 3 for coarse, fine in pairwise(tips)]
    own = compare(extrapolated[-2], extrapolated[-1])  # the scheme is of second order
    table = [[*row, *(100 * e for e in compare(tip, extrapolated[-1]))] for row, tip in zip(rows, tips, strict=True)]
    header = ["steps", "periods", "steady", *(f"{kind} %" for kind in KINDS)]
    title = (
        f"{case.frequency:g} Hz: the reference; own error {100 * own[0]:.1g} % (complex), {100 * own[2]:.1g} % (rms)"
    )
    print_table(title, header, table)
    return {"tip": extrapolated[-1], "own_error": own, "runs": [dict(zip(header, row, strict=True)) for row in table]}


def measure_harmonic(case: Case, reference: np.ndarray, repeats: int, closure: str, tolerance: float) -> list[dict]:
    """Cold solves: errors and times by N; a solve that takes seconds is not repeated."""
    rows = []
    for n in ORDERS:
        runs = []
        while len(runs) < repeats and sum(spent for _, spent in runs) < 3.0:
            runs.append(clock(lambda: solve(case.pose(n, closure), None, tolerance, raise_on_failure=False)))  # noqa: B023
        best, seconds = min(runs, key=lambda run: run[1])
        tip = best.output("tip")
        error = compare(np.array([tip[1], np.linalg.norm(tip[1:]) / np.sqrt(2)]), reference)
        rows.append(
            {
                "closure": closure,
                "tolerance": tolerance,
                "N": n,
                "unknowns": best.unknowns,
                "steps": best.iterations,
                "fallbacks": len(best.fallbacks),
            }
            | {"converged": best.converged, "seconds": seconds, "violation": best.merit["cone_violation"]}
            | {"error": error}
        )
    return rows


def measure_plain(case: Case, start: str | None, reference: np.ndarray) -> list[dict]:
    """Plain stepping: by number of steps, the error at the end and the time at which each level is met for good."""
    rows = []
    for steps in STEPS:
        steady, spent = clock(lambda: integrate(case.pose(), start, steps, PERIODS, tolerance=1e-5))  # noqa: B023
        periods = steady.transient("tip")[:-1].reshape(-1, steps)
        first = 2 * np.fft.fft(periods, axis=1)[:, 1] / steps
        tips = zip(first, periods.std(axis=1), strict=True)
        errors = np.array([compare(np.array(tip), reference) for tip in tips])
        seconds = {}
        for i, kind in enumerate(KINDS):
            for level in LEVELS:
                missed = np.flatnonzero(errors[:, i] > level)
                first_met = missed[-1] + 1 if missed.size else 0
                seconds[kind, level] = spent * (first_met + 1) / len(errors) if first_met < len(errors) else np.inf
        whole = {
            (k, level): spent if steady.converged and e <= level else np.inf
            for k, e in zip(KINDS, errors[-1], strict=True)
            for level in LEVELS
        }
        row = {"steps": steps, "periods": steady.periods, "error": errors[-1].tolist()}
        rows.append(row | {"seconds": seconds, "whole_seconds": whole})
    return rows


def measure_accelerated(case: Case, start: str | None, reference: np.ndarray) -> list[dict]:
    """The same accelerated, stopped at each of the tolerances."""
    rows = []
    for steps in STEPS:
        seconds = {(kind, level): np.inf for kind in KINDS for level in LEVELS}
        for tolerance in TOLERANCES:
            steady, spent = clock(
                lambda: integrate(case.pose(), start, steps, PERIODS, tolerance, acceleration=True)  # noqa: B023
            )
            error = compare(measure_tip(steady), reference)
            for i, kind in enumerate(KINDS):
                for level in LEVELS:
                    if error[i] <= level:
                        seconds[kind, level] = min(seconds[kind, level], spent)
        rows.append({"steps": steps, "periods": steady.periods, "error": error, "seconds": seconds})
    return rows


def pick(rows: list[dict], kind: str, level: float, size: str) -> tuple[int | None, float | None]:
    """Size and time of the fastest of the sizes from which on all larger ones meet the level."""
    time_of = lambda row: row["seconds"][kind, level]  # noqa: E731
    if size == "N":
        meets = lambda row: row["converged"] and row["error"][KINDS.index(kind)] <= level  # noqa: E731
        time_of = lambda row: row["seconds"] if meets(row) else np.inf  # noqa: E731
    missed = [i for i, row in enumerate(rows) if not np.isfinite(time_of(row))]
    usable = rows[missed[-1] + 1 :] if missed else rows
    best = min(usable, key=time_of, default=None)
    return (None, None) if best is None else (best[size], time_of(best))


def summarise(frequency: float, harmonic: dict[tuple[str, float], list[dict]], stepping: dict) -> list[dict]:
    """A row for each closure, kind of error and level: sizes, times and ratios."""
    rows = []
    for closure, kind in product(CLOSURES, KINDS):
        for level in LEVELS:
            picked = {t: pick(harmonic[closure, t], kind, level, "N") for t in SOLVER_TOLERANCES}
            tolerance = min(picked, key=lambda t: picked[t][1] or np.inf)
            n, ours = picked[tolerance]
            theirs = {way: pick(stepping[way], kind, level, "steps")[1] for way in WAYS}
            row = {
                "Hz": frequency,
                "closure": closure,
                "error of": kind,
                "level %": 100 * level,
                "N": n,
                "tolerance": tolerance if n else None,
                "harmonic s": ours,
                "to 1e-8 s": picked[USUAL][1],
            }
            row |= {f"{name} {start} s": theirs[name, start] for name, start in WAYS}
            ratio = lambda seconds: seconds / ours if seconds and ours else None  # noqa: B023, E731
            row |= {f"ratio plain {start}": ratio(theirs["plain", start]) for start in STARTS}
            for name, ways in (("own stop", WAYS[4:]), ("fastest", WAYS)):
                row[f"ratio {name}"] = ratio(min((theirs[way] for way in ways if theirs[way]), default=None))
            rows.append(row | {"to reach": TARGETS.get(level)})
    return rows


def run(case: Case, repeats: int) -> dict:
    """Everything at one frequency."""
    reference = find_reference(case)
    tip, percent = reference["tip"], lambda error: [100 * e for e in error]
    ways = product(CLOSURES, SOLVER_TOLERANCES)
    harmonic = {(closure, t): measure_harmonic(case, tip, repeats, closure, t) for closure, t in ways}
    print_table(
        f"{case.frequency:g} Hz: harmonic solver, cold",
        [
            "closure",
            "tolerance",
            "N",
            "unknowns",
            "converged",
            "steps",
            "fallbacks",
            "s",
            *(f"{kind} %" for kind in KINDS),
            "cone violation",
        ],
        [
            [
                *(
                    r[key]
                    for key in ("closure", "tolerance", "N", "unknowns", "converged", "steps", "fallbacks", "seconds")
                ),
                *percent(r["error"]),
                r["violation"],
            ]
            for rows in harmonic.values()
            for r in rows
        ],
    )
    stepping = {("plain", name): measure_plain(case, start, tip) for name, start in STARTS.items()}
    stepping |= {("accelerated", name): measure_accelerated(case, start, tip) for name, start in STARTS.items()}
    for name in STARTS:
        stepping["own stop", name] = [row | {"seconds": row.pop("whole_seconds")} for row in stepping["plain", name]]
    for (name, start), rows in stepping.items():
        print_table(
            f"{case.frequency:g} Hz: time stepping, {name}, from {start}: seconds to each level of the complex error",
            ["steps", "periods", *(f"{kind} %" for kind in KINDS), *(f"{100 * level:g} %" for level in LEVELS)],
            [
                [r["steps"], r["periods"], *percent(r["error"]), *(r["seconds"]["complex", level] for level in LEVELS)]
                for r in rows
            ],
        )
    return {
        "frequency": case.frequency,
        "reference": reference | {"tip": [[t.real, t.imag] for t in tip]},
        "harmonic": [row for rows in harmonic.values() for row in rows],
        "stepping": [
            {"kind": name, "start": start, **row}
            | {"seconds": [[*key, s if np.isfinite(s) else None] for key, s in row["seconds"].items()]}
            for (name, start), rows in stepping.items()
            for row in rows
        ],
        "summary": summarise(case.frequency, harmonic, stepping),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--frequencies", type=float, nargs="+", default=list(FREQUENCIES), metavar="HZ", help="[1000 1200]"
    )
    parser.add_argument("--repeats", type=int, default=3, help="cold solves, of which the shortest counts [3]")
    parser.add_argument("--output", type=Path, help="JSON file [benchmarks/results/against_time_stepping.json]")
    arguments = parser.parse_args()
    machine, model = describe_machine(), blade_root()
    cases = [Case(model, frequency) for frequency in arguments.frequencies]
    integrate(cases[0].pose(), "rest", 50, 1)  # compiled, modes found
    solve(Case(model, 300.0).pose())
    results = [run(case, arguments.repeats) for case in cases]
    summary = [row for result in results for row in result.pop("summary")]
    title = "Seconds to reach a level, and time stepping's over the harmonic solver's (fastest: of all six)"
    print_table(title, list(summary[0]), [list(row.values()) for row in summary])
    print(f"load average at the end: {os.getloadavg()[0]:.2f}")
    content = {"machine": machine, "friction": FRICTION, "cases": results, "summary": summary}
    write_json("against_time_stepping", content, arguments.output)


if __name__ == "__main__":
    main()
