"""How many hard cases the contact solver solves: cold start, nothing tuned by case.

Three models: the demo's blade root (40 pairs, floating), a dovetail of trusses (6 pairs, floating) and a bolted lap
joint of two beams (7 pairs, nothing floats). The dimensions are those of ``DIMENSIONS``; a case: a level of each.
The full factorial has millions of cases, so a sample is drawn: in every dimension, all levels come equally often
(Latin hypercube), with a fixed seed. Degenerate cases come on top, by name.

A case counts as solved when the solver says so, its residual as evaluated anew is below 1e-8, and everything in the
solution is finite. It counts as failed when the solver says so or has not come back after ``--cap`` seconds of work.
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from statistics import mean, median, stdev

import numpy as np
from degenerate_cases import DEGENERATE
from models import blade_root, damp, dovetail, find_first_mode, lap_joint, shake
from reporting import describe_machine, print_table, write_json

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.errors import EwrError, NotConverged
from ewr_fenicsx.solver.newton_path import RankOneUpdates

TOLERANCE = 1e-8
DEGENERATE_CAP = 120.0  # seconds; a thousand pairs take a few of them a Newton step
MODELS: dict[str, Callable[[], ReducedModel]] = {"blade root": blade_root, "dovetail": dovetail, "lap joint": lap_joint}

DIMENSIONS: dict[str, tuple] = {
    # over the first full-stick mode: its 3:1 and 2:1 sub-harmonics, the resonance and its flanks, beyond
    "frequency": (0.3, 1 / 3, 0.5, 0.7, 0.85, 0.95, 1.0, 1.05, 1.2, 1.5, 2.0, 3.0),
    # harmonic over mean contact forces (norms over all pairs) of the full-stick solution: "reached" at that frequency
    # and damping, from stick to flanks that lift off; "applied" as if the load were static, resonance comes on top
    "load": (
        *(("reached", share) for share in (0.01, 0.1, 0.3, 1.0, 3.0)),
        *(("applied", share) for share in (0.01, 0.03, 0.1, 0.3)),
    ),
    "friction": (0.01, 0.05, 0.2, 0.6, 1.0, 1.5),
    "harmonics": (1, 3, 5, 9, 15, 31),
    "damping": (1e-4, 1e-3, 5e-3, 2e-2, 5e-2),
    # in units of the mean elastic approach under the preload; closed half of the time
    "gap": ("closed", "closed", "closed", "even", "random", "half open"),
    # over the defaults, one or both a thousandfold either way
    "rho": ((1, 1), (1, 1), (1, 1), (1e3, 1), (1e-3, 1), (1, 1e3), (1, 1e-3), (1e3, 1e3), (1e-3, 1e-3)),
}


@dataclass(frozen=True)
class Case:
    """One hard case: a model and a level of each dimension."""

    model: str
    frequency: float
    load: tuple[str, float]
    friction: float
    harmonics: int
    damping: float
    gap: str
    rho: tuple[float, float]

    @property
    def name(self) -> str:
        """The case in one line."""
        return (
            f"{self.model}: {self.frequency:.3g} f1, load {self.load[0]} {self.load[1]:g}, mu {self.friction:g}, "
            f"N {self.harmonics}, damping {self.damping:g}, gap {self.gap}, rho x ({self.rho[0]:g}, {self.rho[1]:g})"
        )


@dataclass(frozen=True)
class Outcome:
    """What became of a case.

    ``status``: "converged", "not converged" (the solver said so), "given up" (the cap), or "wrong" (it said
    converged, or raised, where that is not so).
    ``usual``: it was answered with the default weights, since no way led from these to those asked for.
    ``corners``: that Newton's paths passed, each a right side and no factorisation. ``seconds``: of the processor.
    """

    name: str
    status: str
    reason: str
    residual: float | None
    steps: int
    fallbacks: int
    seconds: float
    usual: bool = False
    corners: int = 0


class CapReached(Exception):
    """A case has used up its time."""


@contextmanager
def limit_work(seconds: float) -> Iterator[None]:
    """Raises ``CapReached`` in the first Newton step after so much processor time."""
    linearise, begin = HarmonicBalance.linearise, time.process_time()

    def watch(self, unknowns, *motion):
        if time.process_time() - begin > seconds:
            raise CapReached
        return linearise(self, unknowns, *motion)

    HarmonicBalance.linearise = watch
    try:
        yield
    finally:
        HarmonicBalance.linearise = linearise


def draw_cases(model: str, count: int, seed: int) -> list[Case]:
    """A sample of hard cases of a model."""
    return [Case(model, **case) for case in draw_levels(DIMENSIONS, count, seed)]


def draw_levels(dimensions: Mapping[str, Sequence], count: int, seed: int) -> list[dict]:
    """A sample with every level of every dimension equally often, up to rounding."""
    rng = np.random.default_rng(seed)
    columns = {}
    for name, levels in dimensions.items():
        rounds = -(-count // len(levels))
        order = np.concatenate([rng.permutation(len(levels)) for _ in range(rounds)])[:count]
        columns[name] = [levels[i] for i in rng.permutation(order)]
    return [{name: column[i] for name, column in columns.items()} for i in range(count)]


@lru_cache(maxsize=32)
def prepare_model(name: str, damping: float) -> tuple[ReducedModel, float]:
    """The damped model and its first full-stick mode [Hz]; few enough to keep."""
    model = damp(MODELS[name](), damping)
    return model, find_first_mode(model)


def pose_case(case: Case) -> ContactProblem:
    """The contact problem of a case; everything is scaled by what the model itself says."""
    problem = pose_on(*prepare_model(case.model, case.damping), case)
    if case.rho == (1, 1):
        return problem
    normal, tangential = (law.rho for law in problem.system.laws)
    return replace(problem, rho_normal=case.rho[0] * normal, rho_tangential=case.rho[1] * tangential)


def pose_on(model: ReducedModel, first: float, case: Case) -> ContactProblem:
    """The same on a damped model whose first mode is given [Hz], with the default weights."""
    frequency = case.frequency * first
    kind, share = case.load
    # quasi-static means far below the first mode
    reference = ContactProblem(model, ContactLaws(), frequency if kind == "reached" else 1e-3 * first, 1)
    forces, _ = HarmonicBalance(reference.system).full_stick
    factor = share * np.linalg.norm(forces[0]) / np.linalg.norm(forces[1])
    model = shake(model, factor)
    flexibility = reference.system.flexibility
    approach = float(np.mean(np.abs(forces[0, : model.pairs])) * np.mean(flexibility[: model.pairs]))
    gap = (
        approach
        * {
            "closed": np.zeros(model.pairs),
            "even": np.full(model.pairs, 0.5),
            "random": np.random.default_rng(model.pairs).uniform(0.0, 1.0, model.pairs),
            "half open": np.where(np.arange(model.pairs) < model.pairs // 2, 1.0, 0.0),
        }[case.gap]
    )
    return ContactProblem(model, ContactLaws(friction=case.friction, initial_gap=gap), frequency, case.harmonics)


def run_case(name: str, pose: Callable[[], ContactProblem], cap: float) -> Outcome:
    """Solve a case cold, and look at what came back."""
    begin, steps, corners = time.process_time(), 0, 0
    linearise, add = HarmonicBalance.linearise, RankOneUpdates.add

    def count(self, unknowns, *motion):
        nonlocal steps
        steps += 1
        return linearise(self, unknowns, *motion)

    def count_corner(self, u, w):
        nonlocal corners
        corners += 1
        return add(self, u, w)

    tell = lambda status, reason, residual=None, fallbacks=0: Outcome(  # noqa: E731
        name, status, reason, residual, steps, fallbacks, time.process_time() - begin, corners=corners
    )
    HarmonicBalance.linearise, RankOneUpdates.add = count, count_corner
    try:
        problem = pose()
        begin = time.process_time()
        posed = replace(problem)
        with limit_work(cap):
            solution = solve(posed, tolerance=TOLERANCE)
    except NotConverged as error:
        best = error.best
        rungs = "; ".join(best.fallbacks)
        told = bool(best.reason) and np.all(np.isfinite(best.forces))
        return tell(
            "not converged" if told else "wrong", f"{best.reason} [{rungs}]", best.residual, len(best.fallbacks)
        )
    except CapReached:
        return tell("given up", f"no answer within {cap:g} s of work")
    except EwrError as error:  # nothing here may be refused: all bodies are held
        return tell("wrong", f"{type(error).__name__}: {error}")
    finally:
        HarmonicBalance.linearise, RankOneUpdates.add = linearise, add
    seconds = time.process_time() - begin
    outcome = judge(solution)
    told = tell(*outcome, fallbacks=len(solution.fallbacks))
    return replace(told, steps=solution.iterations, seconds=seconds, usual=solution.problem is not posed)


def judge(solution) -> tuple[str, str, float]:
    """Status, reason and residual of what ``solve`` returned; the residual evaluated anew, from the forces alone."""
    problem = replace(solution.problem)
    balance = HarmonicBalance(problem.system)
    residual = float(np.linalg.norm(balance.residual(balance.pack(solution.forces, solution.rigid))))
    finite = all(np.all(np.isfinite(a)) for a in (solution.forces, solution.rigid, solution.output("tip")))
    if not finite:
        return "wrong", "the solution has entries that are not finite", residual
    if not solution.converged or not residual <= 1.01 * TOLERANCE:
        return "wrong", f"called converged ({solution.reason}) with residual {residual:.1e}", residual
    return "converged", solution.reason, residual


def run_sampled(argument: tuple[Case, float]) -> Outcome:
    """One case of the sample, as a task of a pool."""
    case, cap = argument
    return run_case(case.name, lambda: pose_case(case), cap)


def run_degenerate(argument: tuple[str, float]) -> Outcome:
    """One degenerate case, as a task of a pool."""
    name, cap = argument
    return run_case(name, DEGENERATE[name], cap)


def run_all(task: Callable, arguments: Sequence, jobs: int) -> Iterator[Outcome]:
    """Outcomes in the order of the arguments."""
    if jobs == 1:
        yield from map(task, arguments)
        return
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:  # MPI and PETSc do not survive a fork
        yield from pool.imap(task, arguments)


def count_up(outcomes: Sequence[Outcome]) -> list[object]:
    """Cases, converged, its share, Newton steps (mean, its standard error, median, max) and corners of those
    converged, fallbacks, seconds.

    Of the fallbacks, those answered with the default weights in place of the asked ones are counted by themselves.
    """
    solved = [o for o in outcomes if o.status == "converged"]
    steps = [o.steps for o in solved] or [0]
    times = [o.seconds for o in outcomes]
    return [
        len(outcomes),
        len(solved),
        100 * len(solved) / len(outcomes),
        float(mean(steps)),
        stdev(steps) / len(steps) ** 0.5 if len(steps) > 1 else 0.0,
        float(median(steps)),
        max(steps),
        float(mean([o.corners for o in solved] or [0])),
        sum(o.fallbacks > 0 for o in outcomes),
        sum(o.usual for o in solved),
        float(mean(times)),
        max(times),
    ]


HEADER = ["cases", "converged", "%", "mean steps", "standard error", "median", "max", "mean corners", "with fallbacks"]
HEADER += ["default weights", "mean s", "max s"]


def tabulate(cases: Sequence[Case], outcomes: Sequence[Outcome]) -> dict[str, list[list[object]]]:
    """Rows by model, and by level of every dimension."""
    tables = {
        "model": [[name, *count_up(picked)] for name in MODELS if (picked := _pick(cases, outcomes, "model", name))]
    }
    tables["model"].append(["all", *count_up(outcomes)])
    for dimension, levels in DIMENSIONS.items():
        tables[dimension] = [
            [_label(level), *count_up(picked)]
            for level in dict.fromkeys(levels)
            if (picked := _pick(cases, outcomes, dimension, level))
        ]
    return tables


def _pick(cases: Sequence[Case], outcomes: Sequence[Outcome], dimension: str, level: object) -> list[Outcome]:
    return [o for c, o in zip(cases, outcomes, strict=True) if getattr(c, dimension) == level]


def _label(level: object) -> str:
    return (
        " ".join(_label(part) for part in level)
        if isinstance(level, tuple)
        else level
        if isinstance(level, str)
        else f"{level:.3g}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=54, help="sampled cases a model [54]")
    parser.add_argument("--full", action="store_true", help="1080 sampled cases a model")
    parser.add_argument("--models", nargs="+", choices=MODELS, default=list(MODELS), help="which models [all]")
    parser.add_argument("--seed", type=int, default=1, help="of the sample [1]")
    parser.add_argument("--cap", type=float, default=20.0, help="processor seconds for a sampled case [20]")
    parser.add_argument("--jobs", type=int, default=1, help="processes [1]")
    parser.add_argument("--output", type=Path, help="JSON file [benchmarks/results/hard_cases.json]")
    parser.add_argument("--progress", action="store_true", help="print each case as it ends")
    arguments = parser.parse_args()
    machine = describe_machine()
    count = 1080 if arguments.full else arguments.cases
    cases = [case for i, name in enumerate(arguments.models) for case in draw_cases(name, count, arguments.seed + i)]
    begin = time.perf_counter()
    outcomes = []
    for outcome in run_all(run_sampled, [(case, arguments.cap) for case in cases], arguments.jobs):
        outcomes.append(outcome)
        if arguments.progress:
            print(f"{outcome.status:14s} {outcome.steps:5d} steps {outcome.seconds:7.2f} s  {outcome.name}", flush=True)
    degenerate = list(run_all(run_degenerate, [(name, DEGENERATE_CAP) for name in DEGENERATE], arguments.jobs))
    spent = time.perf_counter() - begin
    tables = tabulate(cases, outcomes)
    for dimension, rows in tables.items():
        print_table(f"By {dimension}", [dimension, *HEADER], rows)
    print_table(
        "Degenerate cases",
        ["case", "status", "steps", "fallbacks", "residual", "s"],
        [[o.name, o.status, o.steps, o.fallbacks, o.residual, o.seconds] for o in degenerate],
    )
    failures = [o for o in [*outcomes, *degenerate] if o.status != "converged"]
    print(f"\n{len(failures)} failures" + (":" if failures else ""))
    for o in failures:
        print(f"  {o.status}: {o.name}\n      residual {o.residual}, {o.steps} steps, {o.seconds:.1f} s: {o.reason}")
    print(f"\n{len(cases)} sampled and {len(degenerate)} degenerate cases in {spent:.0f} s")
    write_json(
        "hard_cases",
        {
            "machine": machine,
            "seed": arguments.seed,
            "cap_seconds": arguments.cap,
            "columns": HEADER,
            "tables": tables,
            "degenerate": [asdict(o) for o in degenerate],
            "failures": [asdict(o) for o in failures],
            "seconds": spent,
        },
        arguments.output,
    )


if __name__ == "__main__":
    main()
