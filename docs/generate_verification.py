"""Write docs/verification.md: every number in it comes from a run of this script.

    .venv/bin/python docs/generate_verification.py                  some three minutes
    .venv/bin/python docs/generate_verification.py --benchmarks     at once: what benchmarks/results holds

The closed forms are in `verification_cases.py`, the blade root here; the sections on the other code and on times show
benchmarks/results, where those benchmarks have been run.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from markdown_tables import write_table
from verification_cases import NOTES, ROOT, SECTIONS, Case  # puts benchmarks on the path

from models import blade_root, shake  # isort: skip
from reporting import clock  # isort: skip

from ewr_fenicsx import ContactLaws, ContactProblem, integrate, solve

PAGE = ROOT / "docs" / "verification.md"
HEADER = ["case", "quantity", "exact", "ours", "error", "time, s"]
FRICTION, ORDERS = 0.2, (5, 9, 15, 23, 31)
STEPS = (800, 1600, 3200)  # a period, of time stepping on the blade root; the last two are extrapolated to none
BLADE_TITLE = "The blade root: harmonic balance against time stepping"
# name -> frequency [Hz], shaking force over the demo's
BLADE_CASES = {
    "Full stick": (1000.0, 0.1),
    "Some pairs slip": (900.0, 1.0),
    "All pairs slip, some lift off": (1000.0, 1.0),
    "All pairs slip and lift off": (1000.0, 2.0),
}
BLADE_HEADER = ["closure", "N", "tip, %", "tip modulus, %", "tip rms, %", "gaps, %", "normal forces, %"]
BLADE_HEADER += ["friction forces, %", "cone violation", "Newton steps", "time, s"]
CLOSURES = ("dashpot", "spring")


def measure_case(case: Case) -> list[list[object]]:
    """Rows of a case as in the table; the time is that of all its quantities together."""
    name, function, arguments = case
    rows, seconds = clock(lambda: list(function(*arguments)))
    return [[name, row.quantity, row.exact, row.ours, row.error, f"{seconds:.2f}"] for row in rows]


def root_mean_square(error: np.ndarray, scale: np.ndarray) -> str:
    """Over all pairs and instants, in percent."""
    return f"{100 * np.sqrt(np.mean(error**2) / np.mean(scale**2)):.2f}"


def compare_blade_root(frequency: float, load: float) -> tuple[str, list[list[object]]]:
    """Harmonic solutions from cold, and the steady state of time stepping: its contact state, and the errors by N."""
    model = shake(blade_root(), load)
    pose = lambda n: ContactProblem(model, ContactLaws(friction=FRICTION), frequency, n)  # noqa: E731
    settings = [(closure, n) for closure in CLOSURES for n in ORDERS]
    solutions = [clock(lambda c=c, n=n: solve(replace(pose(n), closure=c))) for c, n in settings]
    start, tips, spent = solutions[-1][0], [], 0.0
    for steps in STEPS:
        steady, seconds = clock(
            lambda steps=steps, start=start: integrate(pose(1), start, steps, 100, tolerance=3e-6, acceleration=True)
        )
        start, spent = steady.end, spent + seconds
        tips.append(np.array([steady.output("tip")[1], steady.output_history("tip").std()]))
    tip = tips[-1] + (tips[-1] - tips[-2]) / 3  # the scheme is of second order
    samples = 1024
    gap, normal, friction = (steady.history(name, samples) for name in ("gap", "normal_force", "friction_force"))
    pressed = normal > 1e-3 * normal.max()
    slips = int(((np.abs(friction) > 0.999 * FRICTION * normal) & pressed).any(axis=0).sum())
    opens = int((~pressed).any(axis=0).sum())
    moved = 100 * abs(tips[-1][0] - tip[0]) / abs(tip[0])
    state = f"""{frequency:g} Hz, {load:g} times the demo's shaking. Of {model.pairs} pairs {slips} slip and {opens}
lift off at some time. Reference: the tip moves by {1e3 * abs(tip[0]):.5f} mm, extrapolated from {STEPS[-2]} and
{STEPS[-1]} steps a period. With {STEPS[-1]} steps, which gaps and forces are compared with, it is {moved:.1g} % off
({"steady" if steady.converged else steady.reason}; {spent:.0f} s in all)."""
    rows = []
    for setting, (solution, seconds) in zip(settings, solutions, strict=True):
        y = solution.output("tip")
        rms = np.linalg.norm(y[1:]) / np.sqrt(2)
        gaps, forces, rubs = (
            solution.history(name, samples) for name in ("gap", "normal_force", "admissible_friction_force")
        )
        rows.append(
            [
                *setting,
                f"{100 * abs(y[1] - tip[0]) / abs(tip[0]):.3f}",
                f"{100 * (abs(y[1]) / abs(tip[0]) - 1):+.3f}",
                f"{100 * (rms / tip[1].real - 1):+.3f}",
                root_mean_square(gaps - gap, gap) if opens else "closed",
                root_mean_square(forces - normal, normal),
                root_mean_square(rubs - friction, friction),
                f"{solution.merit['cone_violation']:.3f}",
                solution.iterations,
                f"{seconds:.2f}",
            ]
        )
    return state, rows


def read_results(name: str) -> dict | None:
    """A benchmark's results, None where it has not been run."""
    path = ROOT / "benchmarks" / "results" / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


def describe_peers(found: dict) -> list[str]:
    """The comparison with pyHarm as Markdown."""
    scaled = lambda value, factor=100: None if value is None else factor * value  # noqa: E731
    rows = []
    for c in found["cases"]:
        for name, run in c["peer"].items():
            row = [c["pairs"], c["load"], c["harmonics"], 1e3 * c["our_seconds"], name]
            row += [scaled(run["mean_seconds"], 1000), run["ratio"], f"{run['count']} of {c['points']}"]
            rows.append([*row, *map(scaled, (run["distance"], c["our_error"], run["error"]))])
    header = ["pairs", "load", "N", "ours, ms a point", "pyHarm", "its ms a point", "ratio", "points it solved"]
    header += ["apart, %", "ours from steady, %", "pyHarm's, %"]
    keys = ["pairs", "load", "harmonics", "distance", "our_error", "peer_error", "apart"]
    answers = [[*(row[key] for key in keys[:3]), *(scaled(row[key]) for key in keys[3:])] for row in found["answers"]]
    return [
        f"""Two trusses pressed together and shaken (`benchmarks/peers.py`): the same matrices, law, frequencies,
harmonics and {found["cases"][0]["samples"]} samples in `{found["requirement"]}` (dynamic-Lagrangian contact), as it
comes and with its Jacobian mended; its best run of several penalties and solvers counts. "Ratio" is its time over ours,
at the points that it solved; "apart" is the difference of the two answers; "from steady" that from time stepping.""",
        "",
        write_table(header, rows),
        "",
        """The answers as harmonics are added: largest difference of the tip's first harmonic over a sweep. Where a pair
never slips, its mean friction is free within limits and the laws have neighbouring steady states; each answer is
compared with the one that time stepping reaches from it.""",
        "",
        write_table(
            [
                "pairs",
                "load",
                "N",
                "apart, %",
                "ours from its steady state, %",
                "pyHarm's, %",
                "steady states apart, %",
            ],
            answers,
        ),
    ]


def describe_times(found: dict) -> list[str]:
    """Times to a given error as Markdown."""
    return [
        """Blade root, one thread, processor time (`benchmarks/against_time_stepping.py`): harmonic balance with the
fastest N of those from which on errors stay within the level, against time stepping plain and accelerated, from rest
and from full stick. An oracle that knows the answer stops it as soon as it is within the level; "own stop" is by its
own criterion. Harmonic balance stops at the residual (`tolerance`) that takes the least time within the level; "to
1e-8" is its time with the default one. Ratios are time stepping's time over that of harmonic balance; "to reach" is
the ratio that the project aims at. Empty: not reached with what was tried.

First with the better of the two closures, against the fastest of all ways to step, and against the fastest that stops
by itself; "both by default" is the latter over harmonic balance with its default tolerance, where both stop by
themselves (N, closure and steps are still the oracle's):""",
        "",
        write_table(
            ["Hz", "error of", "level %", "ratio fastest", "ratio own stop", "both by default", "to reach"],
            tell_ratios(found["summary"]),
        ),
        "",
        write_table(list(found["summary"][0]), [list(row.values()) for row in found["summary"]]),
    ]


def tell_ratios(summary: list[dict]) -> list[list[str]]:
    """Time stepping's time over harmonic balance's by frequency, error and level, with the better closure for each."""
    rows = []
    for which in dict.fromkeys((row["Hz"], row["error of"], row["level %"]) for row in summary):
        here = [r for r in summary if (r["Hz"], r["error of"], r["level %"]) == which and r["N"]]
        best = [max((r[f"ratio {way}"] for r in here), default=None) for way in ("fastest", "own stop")]
        shortest = lambda keys: min((r[k] for r in here for k in keys if r[k]), default=None)  # noqa: B023, E731
        ours, theirs = shortest(["to 1e-8 s"]), shortest([f"own stop {start} s" for start in ("rest", "stick")])
        best.append(theirs / ours if ours and theirs else None)
        rows.append([*which, *best, here[0]["to reach"] if here else None])
    return rows


def describe_hard_cases(found: dict) -> list[str]:
    """What converges from cold, and what is known of the rest, as Markdown."""
    rows = [[part, *row] for part in ("model", "load", "harmonics", "rho") for row in found["tables"][part]]
    named = [[o["name"], o["status"], o["steps"], o["seconds"]] for o in found["degenerate"]]
    lines = [
        f"""A sample of the blade root and two smaller joints, cold and without tuning (`benchmarks/hard_cases.py`):
frequencies from 0.3 to 3 times the first full-stick mode, loads from full stick to flanks that lift off, friction 0.01
to 1.5, damping ratios 1e-4 to 5e-2, gaps, and weights rho up to a thousandfold off (`rho`: normal and tangential, over
the defaults; `load`: oscillating over mean contact forces if all pairs held, at that frequency, or "applied" slowly).
The sample (seed {found["seed"]}) was drawn after the solver was made: nothing was tuned on it, though
a defect that it shows may have been mended.
Converged means a residual below 1e-8, evaluated anew; others end with a reason, or after
{found["cap_seconds"]:g} s of work. "Mean corners" are those of
Newton's paths, each a right side and no factorisation: one Newton step serves up to 250 of them. "Default weights"
counts those answered with these, where nothing led to weights far off. A few cases of hundreds of steps decide the mean
steps, and another sample has others: the "standard error" is how far means of such samples lie apart.""",
        "",
        write_table(["by", "", *found["columns"]], rows),
        "",
        write_table(["degenerate case", "", "Newton steps", "s"], named),
    ]
    motions = read_results("failures_in_time")
    if motions is None or not found["failures"]:
        return lines
    told = ", ".join(f"{count} {kind}" for kind, count in motions["motions"].items())
    return [
        *lines,
        "",
        f"""Do those without a solution have a periodic motion at all? Stepped in time for hundreds of periods
(`benchmarks/failures_in_time.py`), their motions turn out {told}. The table shows the relative change of the motion
from one period to the next (median).""",
        "",
        write_table(motions["header"], motions["rows"]),
    ]


def describe_hanging_solids(found: dict) -> list[str]:
    """What converges of solids that friction alone holds, as Markdown."""
    return [
        f"""Solids that friction alone holds along their slot or on their base (`benchmarks/hanging_solids.py`, seed
{found["seed"]}): frequencies from 0.3 to 3 times the first full-stick mode, oscillating forces from 0.01 to 3 times the
mean ones, friction 0.05 to 1, 1 to 9 harmonics, the mean friction resolved or held; cold, nothing tuned by case. A body
that is shaken by more than friction holds walks, and has no periodic motion: `solve` says so. "No answer" is anything
else that did not converge, within {found["cap_seconds"]:g} s. Steps of the static solution, with one harmonic, count
with the others; times are in seconds. "Locked" are the same cases of the roots where an end of the blade is held along
the axis (`supports.hold`).""",
        "",
        write_table(found["header"], found["rows"]),
    ]


def describe_rings(found: dict) -> list[str]:
    """What converges of rings of sectors, and what their solutions say of motions in time, as Markdown."""
    return [
        f"""One sector for all (`benchmarks/rings.py`, seed {found["seed"]}): the rings of the gallery, with the
frequencies, loads, friction, damping and gaps of the hard cases, 1 to 15 harmonics and the default weights; cold,
nothing tuned by case, within {found["cap_seconds"]:g} s. Frequencies of the ring with shrouds are over its first mode
with the joint open. There is no time stepping among the ways to a solution.""",
        "",
        write_table(found["header"], found["rows"]),
        "",
        """Do motions in time leave the waves that are called perhaps unstable (`solution.ring_growth`), and no others?
Small rings of five sectors, stepped for 60 periods from where the solution is; "leave" means that sectors come to
differ by more than three per cent, and go on changing by as much.""",
        "",
        write_table(found["fates_header"], found["fates"]),
    ]


def describe_newton_cost(found: dict) -> list[str]:
    """Times of warm and cold solves over one dense solve as Markdown."""
    keys = ["N", "frequencies", "count", "unknowns", "dense ms", "warm", "cold", "worst warm", "worst cold"]
    keys += ["w steps", "c steps"]
    header = [*keys[:4], "dense solve, ms", *keys[5:9], "Newton steps, warm", "cold"]
    return [
        """Time of a whole solve of the blade root over that of **one** dense `numpy.linalg.solve` of the full system,
in one process (`benchmarks/newton_cost.py`): warm (from the solution 1 % away in frequency) and cold. Medians over 500
to 1500 Hz.""",
        "",
        write_table(header, [[row[key] for key in keys] for row in found["medians"]]),
    ]


def describe_cold_starts(found: dict) -> list[str]:
    """What operator splitting buys as Markdown."""
    return [
        """Blade root, 700 to 1400 Hz, friction 0.05 to 0.4, once and twice the demo's shaking
(`benchmarks/cold_starts.py`): cold starts from where operator splitting ends ([method.md](method.md)), and from full
stick up through growing sets of harmonics, in turn in one process. Steps are means over the problems that both solve;
times their sum, without composing; "apart" is the largest difference of the tip's first harmonic; "iterations a step"
how many of the splitting's take as long as a dense Newton step.""",
        "",
        write_table(found["header"], found["rows"]),
    ]


def describe_scaling(found: dict) -> list[str]:
    """How a Newton step grows with pairs and harmonics as Markdown."""
    keys = ["pairs", "harmonics", "unknowns", "compose_seconds", "step_seconds", "step_megabytes"]
    keys += ["all_rows_seconds", "all_rows_megabytes"]
    header = ["pairs", "N", "unknowns", "compose, s", "step, s", "step, MB", "all rows, s", "all rows, MB"]
    series = found["series"]
    rows = [[m[key] for key in keys] for name in ("pairs", "harmonics") for m in series[name]]
    for name, symbol in (("pairs", "K"), ("harmonics", "N")):
        powers = [found["exponents"][name].get(key) for key in keys[3:]]
        rows.append([f"as a power of {symbol}", "", "", *("" if p is None else f"{p:.1f}" for p in powers)])
    return [
        """Blade root (`benchmarks/scaling.py`): composing a problem and one Newton step from full stick just below
the resonance, where a quarter of the rows change status within the period; "all rows" is the same step with none
eliminated, the worst that any state can cost. Powers are fitted over the upper half of a series.""",
        "",
        write_table(header, rows),
    ]


def describe_reduction(found: dict) -> list[str]:
    """What a mesh costs before the first contact solve as Markdown."""
    return [
        """The gallery's dovetail with ever smaller elements and more pairs (`benchmarks/reduction.py`), each in a
process of its own, wall times. n is the number of reduced coordinates; the bound of a reduction is one sparse
factorisation, its least memory the basis.""",
        "",
        write_table(found["header"], found["table"]),
    ]


def describe_sweep(found: dict) -> list[str]:
    """What a second rank buys as Markdown."""
    rows = [[int(ranks), float(np.median(seconds))] for ranks, seconds in found["seconds"].items()]
    return [
        f"""Six frequency responses of the blade root, {found["points"]} points with five harmonics
(`benchmarks/sweep.py`), wall time, the median of three: two ranks are {found["speed_up"]:.2f} times as fast
as one, and their answers {found["difference"]:.0e} of the largest amplitude apart.""",
        "",
        write_table(["ranks", "s"], rows),
    ]


BENCHMARKS = {
    "Hard cases": ("hard_cases", describe_hard_cases),
    "Solids that hang on friction": ("hanging_solids", describe_hanging_solids),
    "Rings of sectors, cold starts and motions in time": ("rings", describe_rings),
    "Cold starts": ("cold_starts", describe_cold_starts),
    "What a solve costs": ("newton_cost", describe_newton_cost),
    "How a step grows": ("scaling", describe_scaling),
    "From a geometry to the reduced model": ("reduction", describe_reduction),
    "A sweep on two ranks": ("sweep", describe_sweep),
    "Another code: pyHarm": ("peers", describe_peers),
    "Time to a given error: harmonic balance and time stepping": ("against_time_stepping", describe_times),
}
INTRODUCTION = """# Verification

Written by `docs/generate_verification.py`; do not edit. Times are processor seconds on one core, unless said. The cases
are those of `tests/verification`, which assert the errors and the rates at which they fall; sources and derivations are
in the tests' docstrings.
"""
BLADE_NOTE = """Harmonic solutions from cold with default settings, and with springs in place of the default's dashpots
for the harmonics left out ([method.md](method.md)), against the steady state of `integrate`, whose contact laws are
other code. Errors of the tip's first harmonic (complex amplitude, then its modulus) and of the rms of
its oscillation; of gaps, normal forces and admissible friction forces as root mean squares over all pairs and a period,
relative to their own. The cone violation is that of the truncated friction force, over the largest limit."""


def write_benchmarks() -> str:
    """The sections on benchmarks, as their results are now."""
    lines = []
    for title, (name, describe) in BENCHMARKS.items():
        found = read_results(name)
        missing = [f"Not run here: `OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/{name}.py`."]
        lines += [f"## {title}", "", *(missing if found is None else describe(found)), ""]
    return "\n".join(lines).rstrip() + "\n"


def write_cases() -> str:
    """The sections on closed forms and on the blade root, all run anew."""
    lines = [INTRODUCTION]
    for title, cases in SECTIONS.items():
        measure_case(cases[0])  # first calls load and compile things
        rows = [row for case in cases for row in measure_case(case)]
        lines += [
            f"## {title}",
            "",
            *([NOTES[title], ""] if title in NOTES else []),
            write_table(HEADER, rows, digits=6),
            "",
        ]
        print(lines[-2], flush=True)
    lines += [f"## {BLADE_TITLE}", "", BLADE_NOTE, ""]
    for name, setting in BLADE_CASES.items():
        state, rows = compare_blade_root(*setting)
        lines += [f"### {name}", "", state, "", write_table(BLADE_HEADER, rows, digits=6), ""]
        print(name, state, lines[-2], sep="\n", flush=True)
    return "\n".join([*lines, ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=PAGE, help="[docs/verification.md]")
    parser.add_argument("--benchmarks", action="store_true", help="only the sections on benchmarks, from their results")
    arguments = parser.parse_args()
    cases = PAGE.read_text(encoding="utf-8").partition(f"## {next(iter(BENCHMARKS))}\n")[0]
    if not arguments.benchmarks:
        cases = write_cases()
    arguments.output.write_text(cases + write_benchmarks(), encoding="utf-8")
    print(f"wrote {arguments.output}")


if __name__ == "__main__":
    main()
