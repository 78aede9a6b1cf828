"""Our solver and a peer, pyHarm (harmonic balance with dynamic-Lagrangian contact), on the same matrices.

    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/peers.py            1, 4, 10 pairs, two loads: some eight minutes
    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/peers.py --pairs 4 --loads 0.06

Two trusses in a plane, pressed together and shaken: same matrices, law, harmonics, samples and frequencies, each point
started from the one before, one thread and one sweep each. The lighter load slips, and lifts off near the resonance;
the heavier one lifts off at most pairs.

pyHarm is run twice: as it comes, and mended (``pyharm_worker.MendedSystem``: its contact elements leave out of the
Jacobian how the contact forces depend on the rest of the structure, and its solvers then often fail). Either way
several penalties ``eps`` are tried with both of its solvers; the run that solves most points, then the fastest, counts.
Its time a point is the mean over the points that it solved, and so is the time of ours that it is compared with.
Compilation and set-up are not timed on either side. Times are the processes' own (CPU), which other work on the machine
disturbs less.

Answers are compared by the complex first harmonic of the tip, over the largest amplitude of the sweep: the two with
each other, and each with the steady state of time stepping that it leads to. These states can differ: where a pair
never slips, its mean friction is free within limits, and each code has its own way to choose it.

pyHarm lives in an environment of its own, ``build/peers``, which pip fills on first use.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from models import ROOT, find_first_mode, two_trusses
from reporting import describe_machine, print_table, write_json

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate, solve
from ewr_fenicsx.in_time.time_stepping import State
from ewr_fenicsx.solution.solution import PeriodicSolution

ENVIRONMENT = ROOT / "build" / "peers"
REQUIREMENT = "pyHarm-os==1.2.2"
FRICTION, POINTS = 0.3, 24
LOADS = {1: (0.6, 1.0), 4: (0.06, 0.1), 10: (0.06, 0.1)}  # pairs -> shaking forces over the preload
EPS = (0.3, 1.0, 3.0)  # pyHarm's penalty over a contact node's own stiffness
SOLVERS = ("NewtonRaphson", "scipyroot")
VARIANTS = {"as it comes": False, "mended": True}
TOLERANCE = 1e-8  # of the residual, over the natural force
TARGET = {10: 20.0}  # pairs -> how many times faster a point
ORDERS, ANSWERS = (3, 5, 9), {1: 1.0, 4: 0.06}  # of the table of answers: pairs -> load
STEPS, PERIODS = 1600, 200  # of time stepping to the steady state


def choose_frequencies(model: ReducedModel, points: int = POINTS) -> np.ndarray:
    """Frequencies from 0.7 to 1.15 of the first full-stick mode [Hz]."""
    return find_first_mode(model) * np.linspace(0.7, 1.15, points)


def find_environment() -> Path | None:
    """The Python of pyHarm's own virtual environment, None where it has not been made."""
    ready = ENVIRONMENT / "ready"
    if ready.exists() and ready.read_text(encoding="utf-8").strip() == REQUIREMENT:
        return ENVIRONMENT / "bin" / "python"
    return None


def build_environment() -> Path:
    """Find pyHarm's own virtual environment, or make it.

    Returns:
        Its Python.

    Raises:
        RuntimeError: pip could not install pyHarm; carries pip's last lines.
    """
    found = find_environment()
    if found is not None:
        return found
    print(f"installing {REQUIREMENT} with pip into an environment of its own, {ENVIRONMENT}; once", flush=True)
    python = ENVIRONMENT / "bin" / "python"
    subprocess.run([sys.executable, "-m", "venv", "--clear", str(ENVIRONMENT)], check=True)
    run = subprocess.run([python, "-m", "pip", "install", "-q", REQUIREMENT], capture_output=True, text=True)
    if run.returncode:
        tail = "\n".join(run.stderr.strip().splitlines()[-5:])
        raise RuntimeError(f"{REQUIREMENT} did not go into {ENVIRONMENT}; is PyPI within reach? pip says:\n{tail}")
    (ENVIRONMENT / "ready").write_text(REQUIREMENT, encoding="utf-8")
    return python


def run_peer(
    model: ReducedModel,
    frequencies: np.ndarray,
    harmonics: int,
    samples: int,
    *,
    eps: Sequence[float] = EPS,
    solvers: Sequence[str] = SOLVERS,
    variants: Sequence[str] = tuple(VARIANTS),
    most_seconds: float = 60.0,
) -> dict:
    """pyHarm's sweeps of the model, one for each variant, penalty and solver.

    Returns:
        ``"versions"`` of its packages and ``"runs"``, each with its settings and, by point, ``"solved"``, ``"seconds"``
        and ``"coordinates"``: their complex amplitudes ``(n_h, n)``. A sweep that fails at several points on end, or
        takes longer than ``most_seconds``, has fewer points.

    Raises:
        RuntimeError: pyHarm is not to be had or its run broke off; carries the last lines it wrote.
    """
    python = build_environment()
    single = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment |= dict.fromkeys(single, "1") | {"JAX_ENABLE_X64": "1", "JAX_PLATFORMS": "cpu"}
    stiffness = float(np.median(np.diag(model.stiffness)[: 2 * model.pairs]))
    with tempfile.TemporaryDirectory() as folder:  # pyHarm writes a folder of its own into the one where it starts
        case, result = Path(folder) / "case.npz", Path(folder) / "result.json"
        np.savez(
            case,
            mass=model.mass,
            damping=model.damping,
            stiffness=model.stiffness,
            load0=model.load[0],
            load1=model.load[1],
            normal=model.normal,
            tangential=model.tangential,
            pairs=model.pairs,
            friction=FRICTION,
            omegas=2 * np.pi * frequencies,
            harmonics=harmonics,
            samples=samples,
            eps=stiffness * np.asarray(eps, dtype=float),
            solvers=np.array(solvers),
            mended=np.array([VARIANTS[name] for name in variants]),
            tolerance=TOLERANCE,
            most_seconds=most_seconds,
        )
        worker = Path(__file__).with_name("pyharm_worker.py")
        # XLA starts a thread a core whatever it is told
        pin = partial(os.sched_setaffinity, 0, {min(os.sched_getaffinity(0))})
        run = subprocess.run(
            [python, worker, case, result],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            preexec_fn=pin,
        )
        if run.returncode:
            raise RuntimeError("pyHarm's run broke off:\n" + "\n".join(run.stderr.strip().splitlines()[-8:]))
        found = json.loads(result.read_text(encoding="utf-8"))
    names = {mended: name for name, mended in VARIANTS.items()}
    for one in found["runs"]:
        one["variant"] = names[one.pop("mended")]
        one["eps"] /= stiffness
        one["coordinates"] = np.array(one.pop("real")) + 1j * np.array(one.pop("imaginary"))
    return found


def pose(model: ReducedModel, frequency: float, harmonics: int, samples: int | None = None) -> ContactProblem:
    """The problem at one frequency, which shares nothing with those posed before but what is computed once a model."""
    return ContactProblem(model, ContactLaws(friction=FRICTION), float(frequency), harmonics, samples)


def sweep_ours(
    model: ReducedModel, frequencies: np.ndarray, harmonics: int, samples: int, warm: bool = True
) -> tuple[list[PeriodicSolution], np.ndarray]:
    """Our own sweep with default settings, and times a point ``(points,)`` [s]."""
    solutions, seconds = [], []
    for frequency in frequencies:
        begin = time.process_time()
        start = solutions[-1] if warm and solutions else None
        solutions.append(solve(pose(model, frequency, harmonics, samples), start=start, tolerance=TOLERANCE))
        solutions[-1].output("tip")
        seconds.append(time.process_time() - begin)
    return solutions, np.array(seconds)


def read_tip(model: ReducedModel, coordinates: np.ndarray) -> np.ndarray:
    """``(points,)`` complex first harmonic of the tip, from coordinates ``(points, n_h, n)``."""
    return coordinates[:, 1] @ model.outputs["tip"]


def find_steady_tip(model: ReducedModel, frequencies: np.ndarray, coordinates: np.ndarray) -> np.ndarray:
    """``(points,)`` first harmonic of the tip in the steady states of time stepping that harmonic solutions lead to.

    Where some pairs never slip, how much mean friction they keep is a matter of the past, and moves the others: the
    laws have many steady states, side by side. So each solution is held against the one that it starts itself.
    """
    tips = []
    for frequency, amplitudes in zip(frequencies, coordinates, strict=True):
        rate = 2j * np.pi * frequency * np.arange(len(amplitudes))
        state = State(amplitudes.sum(axis=0).real, (rate @ amplitudes).real)
        steady = integrate(pose(model, frequency, 1), state, STEPS, PERIODS, tolerance=1e-6, acceleration=True)
        tips.append(steady.output("tip")[1])
    return np.array(tips)


def measure_distance(a: np.ndarray, b: np.ndarray) -> float | None:
    """Largest difference of complex amplitudes over a sweep, relative to the largest amplitude; None without points."""
    return float(np.abs(a - b).max() / np.abs(b).max()) if len(b) else None


def assess(run: dict, model: ReducedModel, ours: np.ndarray, seconds: np.ndarray) -> dict:
    """A run of pyHarm with its distance from our tips ``(points,)``, its time a point and the ratio to ours."""
    solved = np.flatnonzero(run["solved"])
    mean = float(np.mean(np.array(run["seconds"])[solved])) if solved.size else None
    return {key: run[key] for key in ("variant", "eps", "solver", "jacobian_error")} | {
        "count": int(solved.size),
        "distance": measure_distance(read_tip(model, run["coordinates"][solved]), ours[solved])
        if solved.size
        else None,
        "mean_seconds": mean,
        "ratio": mean / float(np.mean(seconds[solved])) if solved.size else None,
    }


def choose_best(runs: Sequence[dict]) -> dict[str, int]:
    """Variant -> place of the run that solves most points, then the fastest."""
    rank = lambda place: (runs[place]["count"], -(runs[place]["mean_seconds"] or np.inf))  # noqa: E731
    return {
        name: max((place for place, run in enumerate(runs) if run["variant"] == name), key=rank)
        for name in dict.fromkeys(run["variant"] for run in runs)
    }


def compare(pairs: int, load: float, harmonics: int, samples: int, points: int = POINTS) -> dict:
    """Both codes on one model: times a point, ratios, how far the answers are apart and from steady states."""
    model = two_trusses(pairs, load)
    frequencies = choose_frequencies(model, points)
    sweep_ours(model, frequencies[:2], harmonics, samples)  # first calls load and compile things on our side too
    solutions, seconds = sweep_ours(model, frequencies, harmonics, samples)
    _, cold = sweep_ours(model, frequencies, harmonics, samples, warm=False)
    coordinates = np.array([solution.coordinates for solution in solutions])
    ours = read_tip(model, coordinates)
    found = run_peer(model, frequencies, harmonics, samples)
    runs = [assess(run, model, ours, seconds) for run in found["runs"]]
    peer = {}
    for name, place in choose_best(runs).items():
        solved = np.flatnonzero(found["runs"][place]["solved"])
        theirs = found["runs"][place]["coordinates"][solved]
        steady = find_steady_tip(model, frequencies[solved], theirs)
        peer[name] = runs[place] | {
            "error": measure_distance(read_tip(model, theirs), steady),
            "complete": sum(run["count"] == points for run in runs if run["variant"] == name),
        }
    return {
        "pairs": pairs,
        "load": load,
        "harmonics": harmonics,
        "samples": samples,
        "points": points,
        "coordinates": model.size,
        "our_seconds": float(seconds.mean()),
        "our_cold_seconds": float(cold.mean()),
        "our_steps": sum(solution.iterations for solution in solutions) / points,
        "our_error": measure_distance(ours, find_steady_tip(model, frequencies, coordinates)),
        "peer": peer,
        "peer_versions": found["versions"],
        "runs": runs,
    }


def compare_answers(pairs: int, load: float, orders: Sequence[int] = ORDERS, points: int = POINTS // 2) -> list[dict]:
    """The answers of both as harmonics are added, 32 samples each; pyHarm mended, the best of its settings.

    Returns:
        A row for each order with ``"distance"`` of the answers, ``"our_error"`` and ``"peer_error"`` from the steady
        state that each leads to, and how far these states are ``"apart"``, over the points that pyHarm solved.
    """
    model = two_trusses(pairs, load)
    frequencies = choose_frequencies(model, points)
    rows = []
    for n in orders:
        solutions, seconds = sweep_ours(model, frequencies, n, 32 * n)
        ours = np.array([solution.coordinates for solution in solutions])
        found = run_peer(model, frequencies, n, 32 * n, variants=("mended",), eps=EPS[:2], most_seconds=20.0)["runs"]
        runs = [assess(run, model, read_tip(model, ours), seconds) for run in found]
        best = found[choose_best(runs)["mended"]]
        solved = np.flatnonzero(best["solved"])
        row = {"pairs": pairs, "load": load, "harmonics": n, "points": points, "solved": int(solved.size)}
        row |= dict.fromkeys(("distance", "our_error", "peer_error", "apart"))
        if solved.size:
            tips = [read_tip(model, each) for each in (ours[solved], best["coordinates"][solved])]
            steady = [
                find_steady_tip(model, frequencies[solved], each)
                for each in (ours[solved], best["coordinates"][solved])
            ]
            row |= {
                "distance": measure_distance(tips[1], tips[0]),
                "our_error": measure_distance(tips[0], steady[0]),
                "peer_error": measure_distance(tips[1], steady[1]),
                "apart": measure_distance(steady[1], steady[0]),
            }
        rows.append(row)
    return rows


def percent(value: float | None) -> float | None:
    """A share in percent; None stays None."""
    return None if value is None else 100 * value


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--pairs", type=int, nargs="+", choices=LOADS, default=list(LOADS), help="numbers of contact pairs [1 4 10]"
    )
    parser.add_argument("--loads", type=float, nargs="+", help="shaking over preload [0.06 0.1; of one pair 0.6 1]")
    parser.add_argument("--harmonics", type=int, default=5, metavar="N", help="highest harmonic [5]")
    parser.add_argument("--samples", type=int, default=128, help="samples a period, both codes [128]")
    parser.add_argument("--output", type=Path, help="JSON file [benchmarks/results/peers.json]")
    arguments = parser.parse_args()
    machine = describe_machine()
    build_environment()
    results = []
    for pairs in arguments.pairs:
        for load in arguments.loads or LOADS[pairs]:
            results.append(compare(pairs, load, arguments.harmonics, arguments.samples))
            print_table(
                f"pyHarm, {pairs} pairs, load {load}, N = {arguments.harmonics}: every run",
                ["variant", "eps", "solver", "Jacobian off by", "points solved", "s a point", "ratio", "apart %"],
                [
                    [
                        *(run[key] for key in ("variant", "eps", "solver", "jacobian_error")),
                        *(run[key] for key in ("count", "mean_seconds", "ratio")),
                        percent(run["distance"]),
                    ]
                    for run in results[-1]["runs"]
                ],
            )
    answers = [row for pairs in arguments.pairs if pairs in ANSWERS for row in compare_answers(pairs, ANSWERS[pairs])]
    print_table(
        "Answers: largest difference of the tip's first harmonic over a sweep, relative to its largest amplitude",
        ["pairs", "load", "N", "points", "solved", "both %", "ours from steady %", "pyHarm's %", "steady states %"],
        [
            [*(r[key] for key in ("pairs", "load", "harmonics", "points", "solved"))]
            + [percent(r[key]) for key in ("distance", "our_error", "peer_error", "apart")]
            for r in answers
        ],
    )
    header = ["pairs", "load", "N", "warm ms", "cold ms", "steps", "pyHarm", "ms", "ratio", "to reach", "solved", "of"]
    header += ["complete runs", "apart %", "our error %", "pyHarm's %"]
    rows = []
    for r in results:
        for name, run in r["peer"].items():
            row = [r["pairs"], r["load"], r["harmonics"], 1e3 * r["our_seconds"], 1e3 * r["our_cold_seconds"]]
            row += [r["our_steps"], name, run["mean_seconds"] and 1e3 * run["mean_seconds"], run["ratio"]]
            row += [TARGET.get(r["pairs"]), run["count"], r["points"], run["complete"]]
            rows.append([*row, percent(run["distance"]), percent(r["our_error"]), percent(run["error"])])
    print_table("Time a point: pyHarm's best run, over ours at the points that it solved", header, rows)
    print(f"load average at the end: {os.getloadavg()[0]:.2f}")
    content = {"machine": machine, "requirement": REQUIREMENT, "friction": FRICTION, "tolerance": TOLERANCE}
    write_json("peers", content | {"cases": results, "answers": answers}, arguments.output)


if __name__ == "__main__":
    main()
