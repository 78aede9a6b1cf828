"""Is an accuracy that is asked for kept, and what does not knowing the right settings cost?

    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/accuracy_honesty.py              some thirty minutes on one core
    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/accuracy_honesty.py --quick      a minute: few cases

Cases: the sample of `hard_cases.py` (default weights) on the two small models, masses that rub on a rigid wall, others
that rub through stiff springs, the blade root as its demo and the studies load it, and the scenes of the gallery. Those
where no pair ever slips or lifts off are linear and exact with any setting: they are counted, and left out of the
shares. The reference is time stepping to the steady state at two step sizes, extrapolated; a harmonic solve of high
order where time stepping has not settled. Where the two differ by more than a third of the smallest accuracy asked,
neither counts as a reference, and the case is listed: lightly damped contact nodes with a mass of their own may
chatter, and a problem may have several solutions.

The cheapest fixed setting is found by trying: orders, three closures of the friction law (the default: masses or
dashpots; dashpots with the matched weight; springs) and two densities of samples, from cold;
the cheapest counts whose true error meets the accuracy, which a user could not know. Errors do not fall steadily with
the order, so the cheapest may meet the accuracy by chance: beside it stands the cheapest whose next two orders, where
they were tried, meet it as well. Times are the process's own (CPU), short ones the median of three.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from hard_cases import CapReached, draw_cases, limit_work, pose_case
from models import ROOT, blade_root, shake
from mpi4py import MPI
from reporting import clock, describe_machine, print_table, write_json

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate, solve, solve_to_accuracy
from ewr_fenicsx.accuracy.estimates import compare_responses
from ewr_fenicsx.accuracy.levels import SAMPLES
from ewr_fenicsx.accuracy.looking_ahead import choose_samples
from ewr_fenicsx.errors import EwrError
from ewr_fenicsx.problem.dashpots import use_mobility
from ewr_fenicsx.scene.scene import load_scene
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.structure.chain import build_chain, pose_problem

ACCURACIES = (0.1, 0.03, 0.01)
ORDERS = (3, 5, 8, 12, 18, 27, 40)
MOST_UNKNOWNS = 3500  # of fixed settings and references
HIGH_ORDER = 47
FEW_ROWS, HIGHER_ORDER = 4, 191  # of contact, where dashpots close the truncation: the error falls slowly there
STEPS = (800, 1600)
SHORT = 0.5  # seconds, below which a time is taken three times
LINEAR = 1e-6  # error of one harmonic below which nothing slips or lifts off
# the blade root of the studies: frequency [Hz], friction, load over the demo's
BLADE = (
    *((900.0, 0.2, 1.0), (1000.0, 0.2, 1.0), (1200.0, 0.2, 1.0)),
    *((500.0, 0.2, 12.5), (1000.0, 0.1, 1.0), (1050.0, 0.2, 1.0), (1075.0, 0.4, 1.0), (1100.0, 0.2, 1.0)),
)
# the other scenes of the gallery, at a frequency [Hz] near their resonance, and one that is swept all along its sweep
GALLERY = (
    *(("friction_damped_beam", f) for f in (217.0, 150.0, 175.0, 200.0, 225.0, 250.0, 275.0, 300.0)),
    *(("two_blocks", 1000.0), ("dovetail", 1400.0), ("bolted_lap", 250.0), ("tapping_rod", 6000.0)),
    *(("platform_damper", f) for f in (680.0, 710.0, 735.0, 770.0, 790.0)),
)


Result = TypeVar("Result")


@dataclass(frozen=True)
class Reference:
    """Amplitudes of the outputs, ``(n_h, p)`` at harmonics 1.., and how far the two ways to them are apart."""

    response: np.ndarray
    own_error: float | None
    way: str


def time_run(run: Callable[[], Result]) -> tuple[Result, float]:
    """What a run returns, and its processor time; the median of three where it is short."""
    result, spent = clock(run)
    again = [clock(run)[1] for _ in range(2 if spent < SHORT else 0)]
    return result, float(np.median([spent, *again]))


def read(source, highest: int = HIGH_ORDER) -> np.ndarray:
    """Outputs' amplitudes at harmonics 1 to ``highest``, ``(n_h, p)``, of a solution or a steady state."""
    names = source.problem.model.outputs
    response = np.zeros((highest, len(names)), dtype=complex)
    for i, name in enumerate(names):
        for h, amplitude in zip(source.orders, source.output(name), strict=True):
            if 0 < h <= highest:
                response[h - 1, i] = amplitude
    return response


def find_reference(problem: ContactProblem, cap: float) -> Reference | None:
    """The response without truncation, and how well two ways to it agree; None where there is no agreement."""
    high = start = None
    try:
        with limit_work(cap):
            start = solve(replace(problem, harmonics=15))
            rows = problem.system.rows.shape[0]
            if 2 * HIGH_ORDER * rows <= MOST_UNKNOWNS:
                order = HIGHER_ORDER if rows <= FEW_ROWS else HIGH_ORDER
                finer = replace(problem, harmonics=order, samples=16 * order)
                high = solve(finer, start=start)
                if high.unstable:  # a warm start may end on a motion that others leave
                    high = solve(finer)
    except (CapReached, EwrError) as error:
        print(f"         no harmonic reference: {type(error).__name__}")  # time stepping may still get there
    spectrum = replace(problem, harmonics=HIGH_ORDER)
    begin, stepped = time.process_time(), []
    first = high or start
    for steps in STEPS:
        steady = integrate(spectrum, first, steps, periods=80, tolerance=1e-5, acceleration=True)
        if not steady.converged or time.process_time() - begin > 2 * cap:
            break
        stepped.append(read(steady))
        first = steady.end
    if len(stepped) < len(STEPS):
        return None if high is None else Reference(read(high), None, "harmonic")
    response = stepped[1] + (stepped[1] - stepped[0]) / 3  # the scheme is of second order
    if high is None:
        return Reference(response, compare_responses(stepped[1], response), "time stepping")
    return Reference(response, compare_responses(read(high), response), "both")


def try_fixed(problem: ContactProblem, reference: np.ndarray, cap: float) -> list[dict]:
    """Cold solves at fixed settings: error and processor time of each; no further once one takes the cap."""
    rows = []
    for weight in ("default", "mobility", "springs"):
        for density in (SAMPLES, 32):
            for n in ORDERS:
                if 2 * n * problem.system.rows.shape[0] > MOST_UNKNOWNS:
                    break

                def run(n=n, density=density, weight=weight) -> PeriodicSolution:
                    posed = replace(problem, harmonics=n, samples=choose_samples(n, density))
                    if weight == "mobility":
                        posed = use_mobility(posed)
                    return solve(replace(posed, closure="spring") if weight == "springs" else posed)

                try:
                    with limit_work(cap):
                        solution, spent = time_run(run)
                except (CapReached, EwrError):
                    break
                error = compare_responses(read(solution), reference)
                rows.append({"N": n, "weight": weight, "density": density, "error": error, "seconds": spent})
                if error < 0.3 * min(ACCURACIES):
                    break
    return rows


def try_asked(problem: ContactProblem, accuracy: float, reference: np.ndarray, cap: float) -> dict | None:
    """What comes out where an accuracy is asked for; None where the cap was reached or nothing found."""
    try:
        with limit_work(cap):
            found, spent = time_run(lambda: solve_to_accuracy(problem, accuracy))
    except (CapReached, EwrError) as error:
        return {"accuracy": accuracy, "failed": type(error).__name__}
    true = compare_responses(read(found.solution), reference)
    row = {"accuracy": accuracy, "true": true, "estimate": found.estimate.total, "reached": found.reached}
    return row | {"N": found.solution.orders[-1], "levels": len(found.levels), "seconds": spent, "limit": found.limit}


def find_cheapest(fixed: list[dict], accuracy: float, steadily: bool) -> float | None:
    """Least time of the fixed settings that meet an accuracy, ``steadily``: with their next two orders as well."""

    def meets(row: dict) -> bool:
        same = [f for f in fixed if all(f[k] == row[k] for k in ("weight", "density")) and f["N"] >= row["N"]]
        return all(f["error"] <= accuracy for f in same[: 3 if steadily else 1])

    return min((row["seconds"] for row in fixed if meets(row)), default=None)


def is_linear(solution: PeriodicSolution) -> bool:
    """Whether the contact carries no harmonic but those of the loads."""
    loaded = [h for h, f in solution.problem.loads.items() if np.any(f)]
    extra = [j for j, h in enumerate(solution.orders) if h and h not in loaded]
    return bool(np.linalg.norm(solution.forces[extra]) <= LINEAR * np.linalg.norm(solution.forces))


def pose_scene(name: str, frequency: float) -> ContactProblem:
    """The contact problem of a scene in ``demos/`` at a frequency, all knobs at their defaults."""
    chain = build_chain(load_scene(ROOT / "demos" / f"{name}.toml"), MPI.COMM_SELF)
    problem = pose_problem(chain.scene, chain.reduction.model, chain.interface)
    return replace(problem, frequency=frequency, harmonics=5, samples=None, rho_normal=None, rho_tangential=None)


def draw_rubbing_masses(count: int, seed: int) -> Iterator[tuple[str, ContactProblem]]:
    """Names and problems of bodies that nothing elastic parts from the wall on which they rub.

    In turn: one mass; a block that slides and turns on four pairs; three masses in a row, two of which rub. The mass is
    1 kg and has its resonance at 1000 rad/s, the others have theirs near it; the load is 100 N.
    """
    rng = np.random.default_rng(seed)
    for i in range(count):
        ratio, friction = rng.uniform(0.34, 2.2), rng.uniform(0.2, 0.9)
        if i % 3 == 0:
            name, mass, stiffness = "mass on a wall", np.eye(1), 1e6 * np.eye(1)
            rows, load, output = np.ones((1, 1)), [100.0], [1.0]
        elif i % 3 == 1:
            name, mass, stiffness = "block on a wall", np.diag([1.0, 4e-3]), np.diag([1e6, rng.uniform(1e3, 1e4)])
            arms = np.array([0.1, 0.05, -0.05, -0.1])
            rows, load, output = np.column_stack([np.ones(4), arms]), [100.0, rng.uniform(0.0, 8.0)], [1.0, 0.1]
        else:
            name, mass, links = "masses in a row", np.diag(rng.uniform(0.5, 2.0, 3)), rng.uniform(1e6, 4e6, 3)
            stiffness = np.diag(links + np.append(links[1:], 0.0)) - np.diag(links[1:], 1) - np.diag(links[1:], -1)
            rows, load, output = np.eye(3)[1:], [60.0, 0.0, 40.0], [0.0, 0.0, 1.0]
        loss = 10 ** rng.uniform(-3, -1)  # of the stiffness, at the resonance
        model = ReducedModel(mass, 1e-3 * loss * stiffness, stiffness, None, rows, {1: load}, outputs={"x": output})
        laws = ContactLaws("prescribed", normal_force=100.0 / len(rows), friction=friction)
        yield (
            f"{name}: {ratio:.2f} f1, mu {friction:.2f}, damping {loss / 2:.2g}",
            ContactProblem(model, laws, 1000.0 * ratio / (2 * np.pi)),
        )


def draw_dampers(count: int, seed: int) -> Iterator[tuple[str, ContactProblem]]:
    """Names and problems of masses that rub through springs stiffer than their own, as friction dampers do.

    In turn: a mass with one such spring under a given normal force; a body on two pads, behind springs in both
    directions, that slides, bounces and rocks. Masses of 1 kg, with their resonances near 62 Hz; the load is 120 N.
    """
    rng = np.random.default_rng(seed)
    for i in range(count):
        ratio, friction, stiffer = rng.uniform(0.5, 1.4), rng.uniform(0.1, 0.4), 10 ** rng.uniform(0.5, 2.5)
        spring = stiffer * 1.5e5
        if i % 2 == 0:
            name, mass, held = "damper", np.diag([1.0, 0.0]), np.diag([1.5e5, 0.0])
            normal, tangential = np.zeros((1, 2)), np.array([[0.0, 1.0]])
            links, springs = np.array([[1.0, -1.0]]), np.diag([spring])
            laws = ContactLaws("prescribed", normal_force=120.0, friction=friction)
            load = {1: [120.0, 0.0]}
        else:
            name, mass = "two pads", np.diag([1.0, 1.0, 2e-3, 0.0, 0.0, 0.0, 0.0])
            held = np.diag([1.5e5, 5e4, 800.0, 0.0, 0.0, 0.0, 0.0])
            normal, tangential = np.eye(7)[[4, 6]], np.eye(7)[[3, 5]]
            lever, arm = 0.03, 0.05
            body = np.array([[1.0, 0.0, lever], [0.0, 1.0, -arm], [1.0, 0.0, lever], [0.0, 1.0, arm]])
            links, springs = np.hstack([body, -np.eye(4)]), spring * np.diag([1.0, 1.25, 1.0, 1.25])
            laws = ContactLaws(friction=friction)
            load = {0: [0.0, -120.0, 1.0, 0.0, 0.0, 0.0, 0.0], 1: 120.0 * np.eye(7)[0]}
        stiffness = held + links.T @ springs @ links
        loss = 10 ** rng.uniform(-3, -1) / 400.0  # at the resonance
        output = np.eye(len(mass))[0]
        model = ReducedModel(mass, loss * held, stiffness, normal, tangential, load, outputs={"x": output})
        title = f"{name}: {ratio:.2f} f1, mu {friction:.2f}, spring x {stiffer:.0f}, damping {200 * loss:.2g}"
        yield title, ContactProblem(model, laws, 62.0 * ratio)


def list_cases(
    count: int, masses: int, dampers: int, blade: int, gallery: int, seed: int
) -> list[tuple[str, Callable[[], ContactProblem]]]:
    """Names and problems."""
    cases: list[tuple[str, Callable[[], ContactProblem]]] = []
    for i, name in enumerate(("lap joint", "dovetail")):
        for case in draw_cases(name, count, seed + i):
            case = replace(case, rho=(1, 1), harmonics=5)
            cases.append((case.name.split(", rho")[0].replace(", N 5", ""), lambda case=case: pose_case(case)))
    drawn = (*draw_rubbing_masses(masses, seed), *draw_dampers(dampers, seed))
    cases += [(name, lambda problem=problem: problem) for name, problem in drawn]
    for frequency, friction, factor in BLADE[:blade]:

        def pose(frequency=frequency, friction=friction, factor=factor) -> ContactProblem:
            return ContactProblem(shake(blade_root(), factor), ContactLaws(friction=friction), frequency)

        cases.append((f"blade root: {frequency:g} Hz, mu {friction:g}, load x {factor:g}", pose))
    for name, frequency in GALLERY[:gallery]:
        cases.append((f"{name}.toml: {frequency:g} Hz", lambda name=name, f=frequency: pose_scene(name, f)))
    return cases


def run_case(name: str, problem: ContactProblem, cap: float) -> dict:
    """Everything of one case."""
    try:
        with limit_work(cap):
            if is_linear(solve(problem)):
                return {"name": name, "kind": "linear"}
        reference = find_reference(problem, cap)
    except (CapReached, EwrError) as error:
        return {"name": name, "kind": "not solved", "why": type(error).__name__}
    if reference is None:
        return {"name": name, "kind": "no reference"}
    if reference.way == "both" and reference.own_error > min(ACCURACIES) / 3:
        return {"name": name, "kind": "references differ", "own_error": reference.own_error}
    asked = [try_asked(problem, a, reference.response, cap) for a in ACCURACIES]
    fixed = try_fixed(problem, reference.response, cap)
    for row in asked:
        row["cheapest"] = find_cheapest(fixed, row["accuracy"], steadily=False)
        row["cheapest_steady"] = find_cheapest(fixed, row["accuracy"], steadily=True)
    return {"name": name, "kind": "compared", "way": reference.way, "own_error": reference.own_error} | {
        "asked": asked,
        "fixed": fixed,
    }


def summarise(cases: list[dict]) -> list[list[object]]:
    """A row for each accuracy and for all: shares and cost ratios."""
    compared = [c for c in cases if c["kind"] == "compared"]
    table = []
    for accuracy in (*ACCURACIES, None):
        rows = [r for c in compared for r in c["asked"] if accuracy in (None, r["accuracy"])]
        done = [r for r in rows if "true" in r]
        reached = [r for r in done if r["reached"]]
        kept = [r for r in reached if r["true"] <= r["accuracy"]]
        near = [r for r in done if r["true"] / 5 <= r["estimate"] <= 5 * r["true"]]
        ratio, steady = ([r["seconds"] / r[k] for r in reached if r[k]] for k in ("cheapest", "cheapest_steady"))
        share = lambda part, of: 100 * len(part) / len(of) if of else None  # noqa: E731
        table.append(
            [
                "all" if accuracy is None else f"{100 * accuracy:g} %",
                len(rows),
                len(reached),
                share(kept, reached),
                share(near, done),
                float(np.median(ratio)) if ratio else None,
                share([r for r in ratio if r <= 2.5], ratio),
                max(ratio, default=None),
                float(np.median(steady)) if steady else None,
                share([r for r in steady if r <= 2.5], steady),
            ]
        )
    return table


HEADER = ["asked", "cases", "said to be reached", "true error at most asked, %", "estimate within a factor of 5, %"]
HEADER += ["cost over cheapest, median", "at most 2.5, %", "largest"]
HEADER += ["cost over cheapest whose next two orders meet it too, median", "of that at most 2.5, %"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=24, help="sampled cases a small model [24]")
    parser.add_argument("--masses", type=int, default=18, help="masses that rub on a wall [18]")
    parser.add_argument("--dampers", type=int, default=12, help="masses that rub through stiff springs [12]")
    parser.add_argument("--blade", type=int, default=len(BLADE), help="states of the blade root [8]")
    parser.add_argument("--gallery", type=int, default=len(GALLERY), help="states of other scenes [all]")
    parser.add_argument("--seed", type=int, default=11, help="of the sample [11]")
    parser.add_argument("--cap", type=float, default=12.0, help="processor seconds a solve [12]")
    parser.add_argument("--quick", action="store_true", help="4 sampled cases a model, 3 masses, 2 dampers")
    parser.add_argument("--output", type=Path, help="JSON file [benchmarks/results/accuracy_honesty.json]")
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.cases, arguments.masses, arguments.dampers = 4, 3, 2
        arguments.blade = arguments.gallery = 0
    content: dict[str, object] = {"machine": describe_machine(), "seed": arguments.seed, "header": HEADER}
    cases: list[dict] = []
    begin = time.perf_counter()
    counts = arguments.cases, arguments.masses, arguments.dampers, arguments.blade, arguments.gallery
    drawn = list_cases(*counts, arguments.seed)
    for name, pose in drawn:
        case = run_case(name, pose(), arguments.cap)
        cases.append(case)
        told = [
            f"{r['accuracy']:g}: {r.get('true', np.nan):.1e} ({r.get('estimate', np.nan):.1e})"
            for r in case.get("asked", [])
        ]
        print(f"{time.perf_counter() - begin:6.0f} s  {name}: {case['kind']}", *told, sep="; ", flush=True)
        table = summarise(cases)
        kinds = {kind: sum(c["kind"] == kind for c in cases) for kind in dict.fromkeys(c["kind"] for c in cases)}
        content |= {"kinds": kinds, "table": table, "cases": cases, "seconds": time.perf_counter() - begin}
        write_json("accuracy_honesty", content, arguments.output)  # at once: the last cases are the slow ones
    print_table("Asked, and what came out", HEADER, table)
    print("\n" + ", ".join(f"{count} {kind}" for kind, count in kinds.items()))


if __name__ == "__main__":
    main()
