"""What accuracy costs in time on the blade root: every knob by itself, against time stepping.

    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/accuracy_cost.py             some eight minutes on one core
    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/accuracy_cost.py --quick     a minute, few settings
    .venv/bin/python docs/generate_accuracy.py               writes docs/accuracy.md and its pictures from the JSON

At 1000 Hz, near the resonance of the slipping joint, where all flanks slip and half of the pairs lift off for a while.
The reference is `integrate`, steps halved until the response moves by less than can be seen, the outputs extrapolated;
its own error is the change with the last halving, and the distance to a harmonic solve of high order is shown beside
it. Knobs of the structure (modes, mesh, pairs) are turned at N = 5, with the finest of their row as reference, the
finest mesh of degree 2 for both degrees. Times are the process's own (CPU) from cold: of settings medians of three, of
all else single runs; those of a run's stages are wall time. Compilation and what is computed once a model are not
timed.
"""

from __future__ import annotations

import argparse
import json
import time
import tracemalloc
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from hard_cases import Case, pose_case
from models import ROOT
from mpi4py import MPI
from reporting import RESULTS, clock, describe_machine, print_table, write_json
from scipy.optimize import minimize_scalar

from ewr_fenicsx import ContactProblem, Tolerance, evolve_wear, integrate, solve, solve_to_accuracy
from ewr_fenicsx.accuracy.cost import (
    HIGHEST_VARIANT,
    Figures,
    Setting,
    compare_figures,
    list_settings,
    measure_figures,
    survey,
)
from ewr_fenicsx.accuracy.estimates import choose_harmonics, compare_responses
from ewr_fenicsx.runs.cost_report import time_run
from ewr_fenicsx.scene.scene import load_scene
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solver.time_integration import SteadyState
from ewr_fenicsx.structure.chain import build_chain, pose_problem

SCENE = ROOT / "demos" / "blade_root.toml"
ORDERS = (1, 2, 3, 5, 7, 9, 12, 15, 19, 23, 27, 31, 40, 50, 63)
HIGH_ORDER = 63
STEPS, REFERENCE_STEPS = (100, 200, 400, 800, 1600, 3200), (400, 800, 1600, 3200, 6400)
MODES = (2, 4, 8, 15, 30, 60, 120)
MESH_SIZES = (2.8e-3, 2e-3, 1.4e-3, 1e-3, 0.7e-3)
PAIRS = (3, 5, 10, 20)
PEAK, PEAK_ORDERS = (960.0, 1060.0), (1, 3, 5, 9)
PEAK_PRECISION, PEAK_SPAN = 0.02, 3.0  # of the place of a maximum, and between the points of time stepping [Hz]
JUMPS = (0.3, 0.1, 0.03, 0.01, 0.003)
SHARES = (1e-3, 3e-3, 1e-2, 3e-2)


def find_reference(problem: ContactProblem, steps: tuple[int, ...]) -> tuple[Figures, dict[str, float]]:
    """Figures of the steady motion, and their own errors by the last halving of the step."""
    start, found = solve(replace(problem, harmonics=15)), []
    for count in steps:
        posed = replace(problem, harmonics=min(63, (count - 1) // 2))
        steady = integrate(posed, start, count, 100, 1e-5, acceleration=True)
        start = steady.end
        found.append(measure_figures(steady))
        print(f"  reference: {steady.summary()}", flush=True)
    own = compare_figures(found[-2], found[-1])
    output = found[-1].output + (found[-1].output - found[-2].output) / 3  # the scheme is of second order
    return replace(found[-1], output=output), own


def time_steps(problem: ContactProblem, reference: Figures, steps: tuple[int, ...]) -> list[dict]:
    """Rows as of ``survey``: time stepping from full stick until it finds itself steady, plain and accelerated."""
    rows = []
    for knob, accelerated in (("time steps", False), ("time steps, accelerated", True)):
        for count in steps:
            run = partial(integrate, replace(problem), None, count, 120, 1e-4, acceleration=accelerated)
            steady, spent = clock(run)
            steady = replace(steady, problem=replace(problem, harmonics=min(63, count // 2 - 1)))
            row = {"knob": knob, "value": count, "unknowns": count, "steps": steady.periods}
            row |= {"converged": steady.converged, "seconds": spent}
            rows.append(row | {"errors": compare_figures(measure_figures(steady), reference)})
    return rows


def ask_for_accuracy(problem: ContactProblem, reference: Figures, accuracies: tuple[float, ...]) -> list[dict]:
    """Rows as of ``survey``: an accuracy asked for, and what came out."""
    rows = []
    for accuracy in accuracies:
        found, spent = clock(partial(solve_to_accuracy, replace(problem), accuracy))
        row = {"knob": "accuracy asked for", "value": accuracy, "unknowns": found.solution.unknowns}
        row |= {"steps": sum(level.steps for level in found.levels), "converged": True, "seconds": spent}
        row |= {"N": found.solution.orders[-1], "estimate": found.estimate.total, "reached": found.reached}
        rows.append(row | {"errors": compare_figures(measure_figures(found.solution), reference)})
    return rows


def measure_scalars(problem: ContactProblem) -> dict[str, float | complex]:
    """What can be compared between meshes: response, sliding, pressure and wear."""
    solution = solve(problem)
    figures, area = measure_figures(solution), problem.model.pair_area
    return {
        "tip": complex(figures.output[0, 0]),
        "rms": float(np.linalg.norm(figures.output[:, 0])),
        "J_T": float(np.average(figures.sliding, weights=area)),
        "largest pressure": float((figures.normal_force / area).max()),
        "worn volume": float(figures.wear @ area),
        "deepest wear": float(figures.wear.max()),
    }


def turn_structure(quick: bool) -> list[dict]:
    """Modes, mesh size, degree and pairs: against the finest of each row, with the time of each stage."""
    scene = load_scene(SCENE)
    size = lambda v, **more: scene.geometry.model_copy(update={"parameters": {"mesh_size": v, **more}})  # noqa: E731
    degree = lambda v: scene.elasticity.model_copy(update={"degree": v})  # noqa: E731
    modes = lambda v: scene.reduction.model_copy(update={"modes": v})  # noqa: E731
    turns = {
        "modes": [(v, {"reduction": modes(v)}) for v in MODES],
        "mesh size [mm], degree 1": [(1e3 * v, {"geometry": size(v)}) for v in MESH_SIZES],
        "mesh size [mm], degree 2": [
            (1e3 * v, {"geometry": size(v), "elasticity": degree(2)}) for v in MESH_SIZES[: 2 if quick else 3]
        ],
        "pairs a flank, mesh 0.7 mm": [
            (v, {"geometry": size(MESH_SIZES[-1], pairs=v)}) for v in PAIRS[: 3 if quick else 4]
        ],
    }
    rows, measured = [], {}
    for knob, positions in turns.items():
        mine = []
        for value, change in positions:
            chain = build_chain(scene.model_copy(update=change), MPI.COMM_SELF)
            posed = pose_problem(chain.scene, chain.reduction.model, chain.interface)
            found, spent = clock(partial(measure_scalars, posed))
            nodes = chain.structure.space.dofmap.index_map.size_global
            mine.append((value, nodes, chain.interface.area.size, dict(chain.seconds), spent, found))
        measured[knob] = mine
    for knob, mine in measured.items():
        finest = measured["mesh size [mm], degree 2" if knob.startswith("mesh") else knob][-1][5]
        for value, nodes, pairs, seconds, spent, found in mine:
            errors = {name: float(abs(found[name] - finest[name]) / abs(finest[name])) for name in finest}
            row = {"knob": knob, "value": value, "nodes": nodes, "pairs": pairs, "stages": seconds, "solve": spent}
            rows.append(row | {"errors": errors})
    return rows


def fit_peak(frequencies: np.ndarray, heights: Sequence[float]) -> tuple[float, float]:
    """Place and height of the maximum of a parabola through three points."""
    centre = frequencies[1]
    a, b, c = np.polyfit(frequencies - centre, heights, 2)
    return float(centre - b / (2 * a)), float(c - b**2 / (4 * a))


def read_height(source: PeriodicSolution | SteadyState) -> float:
    """Rms of the tip [m]."""
    return float(np.linalg.norm(measure_figures(source).output[:, 0]) / np.sqrt(2))


def turn_peak(problem: ContactProblem, quick: bool) -> dict:
    """Frequency and height of the resonance by N, against time stepping about where the highest N has it.

    Each N is swept over a coarse grid, then its maximum is sought between the neighbours of the highest point. Time
    stepping takes a parabola through three points close by; its own error is the change with the last halving.
    """
    grid = np.linspace(*PEAK, 4 if quick else 9)
    rows = []
    for n in PEAK_ORDERS[: 2 if quick else 4]:
        begin, solution, solutions = time.process_time(), None, []
        for frequency in grid:
            solution = solve(replace(problem, frequency=float(frequency), harmonics=n), start=solution)
            solutions.append(solution)
        top = int(np.clip(np.argmax(list(map(read_height, solutions))), 1, len(grid) - 2))

        def lower(frequency: float, near: PeriodicSolution = solutions[top]) -> float:
            return -read_height(solve(replace(near.problem, frequency=float(frequency)), start=near))

        found = minimize_scalar(
            lower, bounds=(grid[top - 1], grid[top + 1]), method="bounded", options={"xatol": PEAK_PRECISION}
        )
        rows.append([n, float(found.x), -float(found.fun), time.process_time() - begin])
    start, stepped, near = solutions[top], [], rows[-1][1] + np.array([-1.0, 0.0, 1.0]) * PEAK_SPAN
    for steps in (50, 100) if quick else (400, 800):
        begin, heights = time.process_time(), []
        for frequency in near:
            posed = replace(problem, frequency=float(frequency), harmonics=min(31, (steps - 1) // 2))
            steady = integrate(posed, start, steps, 100, 1e-5, acceleration=True)
            start = steady.end
            heights.append(read_height(steady))
        stepped.append([*fit_peak(near, heights), time.process_time() - begin])
    coarse, reference = stepped
    return {
        "reference": reference,
        "own_error": [abs(coarse[i] / reference[i] - 1) for i in range(2)],
        "rows": [[n, f, h, f / reference[0] - 1, h / reference[1] - 1, spent] for n, f, h, spent in rows],
    }


def turn_wear(problem: ContactProblem, quick: bool) -> list[dict]:
    """Cycle jumps against every cycle: errors of the worn depth, solves and time."""
    cycles, coefficient = (20 if quick else 100), 2e-12
    rows, exact = [], None
    for tolerance in (None, *JUMPS):
        jump = None if tolerance is None else Tolerance(share=tolerance)
        posed, options = replace(problem, harmonics=3), {"keep_every": cycles, "progress": False}
        history, spent = clock(partial(evolve_wear, posed, cycles, coefficient, jump, **options))
        depth = history.depth[-1]
        exact = depth if exact is None else exact
        off = depth - exact
        row = {"tolerance": tolerance, "solves": history.solves, "seconds": spent}
        row |= {"largest": float(np.abs(off).max() / exact.max())}
        rows.append(row | {"L2": float(np.linalg.norm(off) / np.linalg.norm(exact))})
    return rows


def adapt_harmonics(problem: ContactProblem, quick: bool) -> list[dict]:
    """All harmonics against those chosen by their contact forces: unknowns, time and what it changes."""
    lap = Case("lap joint", 2.0, ("reached", 0.3), 0.01, 5, 0.02, "closed", (1, 1))
    root = Case("dovetail", 0.95, ("reached", 1.0), 0.05, 5, 0.05, "closed", (1, 1))
    cases = {"blade root, 1000 Hz": (problem, 9 if quick else 23)}
    cases |= {case.name.split(", N")[0]: (pose_case(case), 31) for case in (lap, root)}
    rows = []
    for name, (posed, n) in cases.items():
        full, spent = clock(partial(solve, replace(posed, harmonics=n)))
        rows.append({"case": name, "share": 0.0, "harmonics": len(full.orders), "unknowns": full.unknowns})
        rows[-1] |= {"seconds": spent, "change": 0.0}
        for share in SHARES:
            kept = choose_harmonics(full, share)
            fewer, spent = clock(partial(solve, replace(posed, harmonics=kept, samples=full.problem.basis.samples)))
            change = compare_responses(measure_figures(fewer).output, measure_figures(full).output)
            rows.append({"case": name, "share": share, "harmonics": len(kept), "unknowns": fewer.unknowns})
            rows[-1] |= {"seconds": spent, "change": change}
    return rows


def time_stages(repeats: int, orders: tuple[int, ...]) -> dict:
    """Wall time of every stage of a run, first (with compilation, where nothing is cached) and at best; memory."""
    scene, runs = load_scene(SCENE), []
    for _ in range(repeats):
        chain = build_chain(scene, MPI.COMM_SELF)
        runs.append(time_run(chain))
    problem = pose_problem(scene, chain.reduction.model, chain.interface)
    solves = []
    for n in orders:
        tracemalloc.start()
        solution = solve(replace(problem, harmonics=n))
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        solves.append({"N": n, "unknowns": solution.unknowns, "peak_MB": peak / 1e6})
    stages = {k: [runs[0][k], min(r[k] for r in runs[1:])] for k in runs[0]}
    return {"stages": stages, "memory": solves}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = ("structure", "accuracies", "stages", "peak")
    parser.add_argument("--only", choices=parts, help="measure that part anew, keep the rest")
    parser.add_argument(
        "--quick", action="store_true", help="few settings and coarse references: a trial of the script"
    )
    parser.add_argument("--highest", type=int, default=ORDERS[-1], help="highest N tried [63]")
    parser.add_argument(
        "--repeats", type=int, default=3, help="cold solves of a setting, of which the median counts [3]"
    )
    parser.add_argument("--output", type=Path, help="JSON file [benchmarks/results/accuracy_cost.json]")
    arguments = parser.parse_args()
    quick, content, begin = arguments.quick, {"machine": describe_machine()}, time.perf_counter()
    orders = tuple(n for n in ORDERS if n <= arguments.highest and (n in (1, 5) or not quick))

    def keep(what: str, **found: object) -> None:
        """What was found so far is on disk, whatever happens to the rest."""
        content.update(found, seconds=time.perf_counter() - begin)
        write_json("accuracy_cost", content, arguments.output)
        print(f"{content['seconds']:6.0f} s  {what}", flush=True)

    if arguments.only:
        kept = json.loads((arguments.output or RESULTS / "accuracy_cost.json").read_text(encoding="utf-8"))
        content = kept | content
    if arguments.only == "structure":
        return keep("structure", structure=turn_structure(quick))
    if arguments.only == "stages":
        return keep("stages", stages=time_stages(2 if quick else 3, (3, 5) if quick else (5, 9, 15)))
    scene = load_scene(SCENE)
    chain = build_chain(scene, MPI.COMM_SELF)
    problem = pose_problem(scene, chain.reduction.model, chain.interface)
    if arguments.only == "peak":
        return keep("peak", peak=turn_peak(problem, quick))
    reference, own = find_reference(problem, (100, 200) if quick else REFERENCE_STEPS)
    high = replace(problem, harmonics=9 if quick else HIGH_ORDER)
    agreement = compare_figures(measure_figures(solve(high)), reference)
    if arguments.only == "accuracies":
        kept = [r for r in content["rows"] if r["knob"] != "accuracy asked for"]
        return keep("accuracies", rows=kept + ask_for_accuracy(problem, reference, (0.1, 0.03, 0.01)))
    found = {"own_error": own, "agreement": agreement, "high_order": high.harmonics}
    keep("reference", quick=quick, errors=list(agreement), frequency=problem.frequency, **found)
    settings = list_settings(problem, orders, fixed=5 if quick else 9)
    zero = replace(problem, laws=replace(problem.laws, static_friction="zero"))
    settings += [
        Setting('N, static friction "zero"', n, replace(zero, harmonics=n)) for n in orders if n <= HIGHEST_VARIANT
    ]
    rows = survey(settings, reference, 1 if quick else arguments.repeats)
    keep(f"{len(rows)} settings", rows=rows)
    rows += ask_for_accuracy(problem, reference, (0.3,) if quick else (0.1, 0.03, 0.01))
    keep("accuracies asked for", rows=rows)
    rows += time_steps(problem, reference, STEPS[:1] if quick else STEPS)
    keep("time stepping", rows=rows)
    short = ("output", "rms", "J_T", "largest normal force", "normal forces", "wear", "coulomb")
    print_table(
        "Every knob by itself: relative errors, %",
        ["knob", "value", "unknowns", "steps", "s", *short],
        [
            [r["knob"], r["value"], r["unknowns"], r["steps"], r["seconds"], *(100 * r["errors"][e] for e in short)]
            for r in rows
        ],
    )
    keep("structure", structure=turn_structure(quick))
    keep("adapted harmonics", adapted=adapt_harmonics(problem, quick))
    keep("wear", wear=turn_wear(problem, quick))
    keep("stages", stages=time_stages(2 if quick else 3, (3, 5) if quick else (5, 9, 15)))
    keep("peak", peak=turn_peak(problem, quick))
    for title, table in (("Wear", content["wear"]), ("Adapted harmonics", content["adapted"])):
        print_table(title, list(table[0]), [list(row.values()) for row in table])


if __name__ == "__main__":
    main()
