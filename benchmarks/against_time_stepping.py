"""Time to a given error: the harmonic solver from cold against time stepping, on the blade root.

    .venv/bin/python benchmarks/against_time_stepping.py                     1000, 1200 and 900 Hz; an hour less than two
    .venv/bin/python benchmarks/against_time_stepping.py --frequencies 1000

Errors are those of the tip: of its complex first harmonic, and of the rms of its oscillation, both against time stepping
with thousands of steps, extrapolated to none. That reference is made twice, with other steps and another start; how far
the two are apart is its own error.

What counts is the smallest N, or number of steps, from which on all larger ones tried meet the level. Time stepping is
told by an oracle when to stop: plain, at the first period from which on its error meets the level; accelerated, at the
loosest of three tolerances that meets it. A user has no such oracle and pays more. One thread; compilation, and what is
computed once a model, are not timed.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from models import blade_root
from reporting import describe_machine, print_table, write_json

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate, solve
from ewr_fenicsx.time_integration import SteadyState

FREQUENCIES = (1000.0, 1200.0, 900.0)
LEVELS = (0.03, 0.01, 0.003, 0.001)
ORDERS = (3, 5, 7, 9, 12, 15, 19, 23, 27, 31, 39, 47)
STEPS = (100, 200, 400, 800, 1600, 3200)
PERIODS = 120
TOLERANCES = (1e-2, 1e-3, 1e-4)  # of accelerated runs
REFERENCES = ((6400, 12800, "rest"), (5000, 10000, None))  # steps, twice as many, start
TARGETS = {0.01: 20.0, 0.001: 1.0}  # level -> how many times faster the harmonic solver is to be
KINDS = ("first harmonic", "rms")


def pose(model: ReducedModel, frequency: float, friction: float, harmonics: int = 1) -> ContactProblem:
    """A problem that shares nothing with those posed before, but what is computed once a model."""
    return ContactProblem(model, ContactLaws(friction=friction), frequency, harmonics)


def measure_tip(steady: SteadyState) -> np.ndarray:
    """``(2,)`` complex first harmonic and rms of the oscillation [m], over the last period."""
    return np.array([steady.output("tip")[1], steady.output_history("tip").std()])


def find_reference(model: ReducedModel, frequency: float, friction: float) -> dict[str, object]:
    """Steady tip motion without truncation or step error, and how far two ways to it are apart."""
    problem, found, runs = pose(model, frequency, friction), [], []
    for few, many, start in REFERENCES:
        # from few steps to many: the transient dies while steps are cheap
        for steps in (few // 4, few // 2, few, many):
            steady = integrate(problem, start, steps, periods=60, tolerance=1e-6, acceleration=True)
            start = steady.end
            runs.append((steps, steady.periods, steady.converged, measure_tip(steady)))
        coarse, fine = runs[-2][3], runs[-1][3]
        found.append(fine + (fine - coarse) / 3)  # the scheme is of second order
    apart = np.abs(found[1] - found[0]) / np.abs(found[0])
    rows = [[n, p, "yes" if c else "no", *compare(tip, found[0])] for n, p, c, tip in runs]
    print_table(
        f"{frequency:g} Hz: the references, {apart[0]:.1e} (first harmonic) and {apart[1]:.1e} (rms) apart",
        ["steps", "periods", "steady", *KINDS],
        rows,
    )
    return {"tip": found[0], "apart": apart, "runs": [dict(zip(("steps", "periods", "steady", *KINDS), r)) for r in rows]}


def compare(tip: np.ndarray, reference: np.ndarray) -> list[float]:
    """Relative errors of the complex first harmonic and of the rms."""
    return [float(abs(tip[0] - reference[0]) / abs(reference[0])), float(abs(tip[1] / reference[1] - 1))]


def measure_harmonic(model: ReducedModel, frequency: float, friction: float, reference: np.ndarray, repeats: int) -> list[dict]:
    """Cold solves with default settings: errors and times by N."""
    rows = []
    for n in ORDERS:
        runs = []
        for _ in range(repeats):
            runs.append(solve(pose(model, frequency, friction, n), raise_on_failure=False))
            if runs[-1].seconds > 20.0:
                break
        best = min(runs, key=lambda s: s.seconds)
        tip = best.output("tip")
        error = compare(np.array([tip[1], np.linalg.norm(tip[1:]) / np.sqrt(2)]), reference)
        if not best.converged:
            error = [np.inf, np.inf]
        rows.append(
            {"N": n, "unknowns": best.unknowns, "steps": best.iterations, "fallbacks": len(best.fallbacks)}
            | {"converged": best.converged, "seconds": best.seconds, "error": error, "violation": best.merit["cone_violation"]}
        )
    return rows


def measure_plain(model: ReducedModel, frequency: float, friction: float, start: str | None, reference: np.ndarray) -> list[dict]:
    """Plain stepping: by number of steps, the error at the end and the time at which each level is met for good."""
    rows = []
    for steps in STEPS:
        steady = integrate(pose(model, frequency, friction), start, steps, PERIODS, tolerance=1e-6)
        periods = steady.transient("tip")[:-1].reshape(-1, steps)
        first = 2 * np.fft.fft(periods, axis=1)[:, 1] / steps
        errors = np.array([compare(np.array(tip), reference) for tip in zip(first, periods.std(axis=1))])
        seconds = {}
        for i, kind in enumerate(KINDS):
            for level in LEVELS:
                missed = np.flatnonzero(errors[:, i] > level)
                first_met = missed[-1] + 1 if missed.size else 0
                met = first_met < len(errors)
                seconds[kind, level] = steady.seconds * (first_met + 1) / len(errors) if met else np.inf
        rows.append({"steps": steps, "periods": steady.periods, "error": errors[-1].tolist(), "seconds": seconds})
    return rows


def measure_accelerated(
    model: ReducedModel, frequency: float, friction: float, start: str | None, reference: np.ndarray
) -> list[dict]:
    """The same accelerated, stopped at each of the tolerances."""
    rows = []
    for steps in STEPS:
        seconds = {(kind, level): np.inf for kind in KINDS for level in LEVELS}
        for tolerance in TOLERANCES:
            problem = pose(model, frequency, friction)
            steady = integrate(problem, start, steps, PERIODS, tolerance, acceleration=True)
            error = compare(measure_tip(steady), reference)
            for i, kind in enumerate(KINDS):
                for level in LEVELS:
                    if error[i] <= level:
                        seconds[kind, level] = min(seconds[kind, level], steady.seconds)
        rows.append({"steps": steps, "periods": steady.periods, "error": error, "seconds": seconds})
    return rows


def pick(rows: list[dict], kind: str, level: float, size: str) -> dict:
    """The fastest of the sizes that meet the level, of those from which on all larger ones do."""
    time_of = lambda row: row["seconds"][kind, level]  # noqa: E731
    if size == "N":
        time_of = lambda row: row["seconds"] if row["error"][KINDS.index(kind)] <= level else np.inf  # noqa: E731
    missed = [i for i, row in enumerate(rows) if not np.isfinite(time_of(row))]
    usable = rows[missed[-1] + 1 :] if missed else rows
    if not usable:
        return {"size": None, "seconds": None}
    best = min(usable, key=time_of)
    return {"size": best[size], "seconds": time_of(best)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frequencies", type=float, nargs="+", default=list(FREQUENCIES), metavar="HZ", help="[1000 1200 900]")
    parser.add_argument("--friction", type=float, default=0.2, help="friction coefficient [0.2]")
    parser.add_argument("--repeats", type=int, default=3, help="cold solves, of which the shortest counts [3]")
    parser.add_argument("--output", type=Path, help="JSON file [benchmarks/results/against_time_stepping.json]")
    arguments = parser.parse_args()
    machine, model, friction = describe_machine(), blade_root(), arguments.friction
    integrate(pose(model, 1000.0, friction), "rest", 50, 1)  # compiled, modes found
    solve(pose(model, 300.0, friction))
    results, summary = [], []
    for frequency in arguments.frequencies:
        reference = find_reference(model, frequency, friction)
        tip = reference["tip"]
        harmonic = measure_harmonic(model, frequency, friction, tip, arguments.repeats)
        percent = lambda error: [100 * e for e in error]  # noqa: E731
        print_table(
            f"{frequency:g} Hz: harmonic solver, cold",
            ["N", "unknowns", "Newton steps", "fallbacks", "s", *(f"{kind} error %" for kind in KINDS), "cone violation"],
            [
                [r["N"], r["unknowns"], r["steps"], r["fallbacks"], r["seconds"], *percent(r["error"]), r["violation"]]
                for r in harmonic
            ],
        )
        stepping = {
            (name, label): measure(model, frequency, friction, start, tip)
            for name, measure in (("plain", measure_plain), ("accelerated", measure_accelerated))
            for label, start in (("rest", "rest"), ("full stick", None))
        }
        for (name, label), rows in stepping.items():
            print_table(
                f"{frequency:g} Hz: time stepping, {name}, from {label}: seconds to each level of the first harmonic's error",
                ["steps", "periods", *(f"{kind} error %" for kind in KINDS), *(f"{100 * level:g} %" for level in LEVELS)],
                [
                    [r["steps"], r["periods"], *percent(r["error"]), *(r["seconds"][KINDS[0], level] for level in LEVELS)]
                    for r in rows
                ],
            )
        for kind in KINDS:
            for level in LEVELS:
                ours = pick(harmonic, kind, level, "N")
                theirs = {key: pick(rows, kind, level, "steps") for key, rows in stepping.items()}
                ratios = {
                    key: t["seconds"] / ours["seconds"] if ours["seconds"] and t["seconds"] else None for key, t in theirs.items()
                }
                summary.append(
                    [frequency, kind, 100 * level, ours["size"], ours["seconds"]]
                    + [theirs[key]["seconds"] for key in stepping]
                    + [ratios[key] for key in stepping]
                    + [TARGETS.get(level)]
                )
        results.append(
            {
                "frequency": frequency,
                "reference": {"tip": [[t.real, t.imag] for t in tip], "apart": reference["apart"], "runs": reference["runs"]},
                "harmonic": harmonic,
                "stepping": [
                    {"kind": name, "start": label, **row, "seconds": [[*key, s] for key, s in row["seconds"].items()]}
                    for (name, label), rows in stepping.items()
                    for row in rows
                ],
            }
        )
    header = ["Hz", "error of", "level %", "N", "harmonic s", "plain rest s", "plain stick s", "acc. rest s", "acc. stick s"]
    header += ["ratio p.r.", "p.s.", "a.r.", "a.s.", "to reach"]
    print_table("Seconds to reach a level, and time stepping's over the harmonic solver's", header, summary)
    print(f"load average at the end: {describe_machine()['load_average'][0]}")
    content = {"machine": machine, "friction": friction, "cases": results}
    write_json("against_time_stepping", content | {"summary": [dict(zip(header, row)) for row in summary]}, arguments.output)


if __name__ == "__main__":
    main()
