"""Hard cases of solids that friction alone holds along their slot, or on their base: cold start, nothing tuned by case.

    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/hanging_solids.py                some fifteen minutes

A block on a wider one (30 pairs), a dovetail (40) and a fir tree (36), the two roots at a broach angle; and for
comparison the same cases of the roots with a lock, which holds an end of the blade along the axis. Cases are drawn as
in ``hard_cases.py``: in every dimension all levels come equally often. A body that is shaken by more than friction
holds walks and has no periodic motion: such cases are counted by themselves.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path
from statistics import mean, median

import numpy as np
from hard_cases import Outcome, draw_levels, run_case
from models import ROOT, find_first_mode, shake
from reporting import describe_machine, print_table, write_json

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, Scene, build_reduced_model
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.in_time.walking import WALKS

PROFILES = {
    "two_blocks": {"depth": 30e-3, "layers": 4, "pairs": 6, "mesh_size": 8e-3},
    "dovetail": {"depth": 20e-3, "layers": 3, "pairs": 5, "mesh_size": 2e-3, "skew": 10.0},
    "fir_tree": {"depth": 20e-3, "layers": 2, "pairs": 3, "mesh_size": 4e-3, "skew": 15.0},
}
DIMENSIONS: dict[str, tuple] = {
    "frequency": (0.3, 0.5, 0.85, 0.95, 1.0, 1.05, 1.2, 1.5, 2.0, 3.0),  # over the first full-stick mode
    "load": (0.01, 0.1, 0.3, 1.0, 3.0),  # harmonic over mean contact forces of full stick (norms over all pairs)
    "friction": (0.05, 0.1, 0.2, 0.3, 0.6, 1.0),
    "static_friction": ("resolved", "resolved", "held"),
    "harmonics": (1, 3, 5, 9),
}
MODELS = {  # name -> profile, seed of its cases less that of the sample, what holds the blade along the axis
    "two blocks": ("two_blocks", 0, {}),
    "dovetail": ("dovetail", 1, {}),
    "fir tree": ("fir_tree", 2, {}),
    "dovetail, locked": ("dovetail", 1, {"back_blade": "z"}),
    "fir tree, locked": ("fir_tree", 2, {"back_blade": "z"}),
}
HEADER = ["model", "pairs", "cases", "converged", "walk", "no answer", "mean steps", "median", "most"]
HEADER += ["with fallbacks", "mean s", "max s"]


@lru_cache(maxsize=5)
def build(name: str) -> ReducedModel:
    """The model of a profile drawn out, pulled or pressed along y and shaken along x and z."""
    profile, _, hold = MODELS[name]
    blocks = profile == "two_blocks"
    end, pull = ("top", -2000.0) if blocks else ("tip", 8000.0)
    bodies = {"body_a": "upper", "body_b": "lower"} if blocks else {}
    scene = {
        "geometry": {
            "source": str(ROOT / "geometry" / "extruded.py"),
            "parameters": {"profile": profile, **PROFILES[profile]},
        },
        "contact": bodies,
        "supports": {"hold": hold},
        "loads": {
            "pull": {"boundary": end, "force": [0.0, pull, 0.0]},
            "shake": {"boundary": end, "force": [20.0, 0.0, 10.0], "harmonic": 1},
        },
        "outputs": {"tip": {"boundary": end, "direction": [1.0, 0.0, 0.0]}},
        "excitation": {"frequency": 1000.0},
    }
    return build_reduced_model(Scene.model_validate(scene))


def pose(name: str, case: dict) -> ContactProblem:
    """The contact problem of a case."""
    model = build(name)
    laws = ContactLaws(friction=case["friction"], static_friction=case["static_friction"])
    problem = ContactProblem(model, laws, case["frequency"] * find_first_mode(model), case["harmonics"])
    forces, _ = HarmonicBalance(problem.system).full_stick
    factor = case["load"] * np.linalg.norm(forces[0]) / np.linalg.norm(forces[1:])
    return replace(problem, model=shake(model, factor))


def walks(outcome: Outcome) -> bool:
    """Whether the solver ended by saying that a body walks."""
    return outcome.status == "not converged" and WALKS in outcome.reason.partition(" [")[0]


def count_up(outcomes: Sequence[Outcome]) -> list[object]:
    """The columns of ``HEADER`` from the third on; steps are those of converged cases."""
    solved = [o for o in outcomes if o.status == "converged"]
    walking = sum(map(walks, outcomes))
    steps, seconds = [o.steps for o in solved] or [0], [o.seconds for o in outcomes]
    ended = [len(outcomes), len(solved), walking, len(outcomes) - len(solved) - walking]
    fallbacks = sum(o.fallbacks > 0 for o in outcomes)
    return [*ended, mean(steps), median(steps), max(steps), fallbacks, mean(seconds), max(seconds)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=60, help="a model [60]")
    parser.add_argument("--seed", type=int, default=1, help="of the sample [1]")
    parser.add_argument("--cap", type=float, default=60.0, help="processor seconds for a case [60]")
    parser.add_argument("--output", type=Path, help="JSON file [benchmarks/results/hanging_solids.json]")
    arguments = parser.parse_args()
    machine = describe_machine()
    rows, failures, everything = [], [], []
    for name, (_, seed, hold) in MODELS.items():
        outcomes = []
        for case in draw_levels(DIMENSIONS, arguments.cases, arguments.seed + seed):
            told = f"{name}: {', '.join(f'{k} {v}' for k, v in case.items())}"
            outcomes.append(run_case(told, lambda n=name, c=case: pose(n, c), arguments.cap))
        everything += [] if hold else outcomes
        rows.append([name, build(name).pairs, *count_up(outcomes)])
        failures += [o for o in outcomes if o.status != "converged" and not walks(o)]
    rows.insert(-2, ["all that hang", "", *count_up(everything)])
    print_table("Solids that hang on friction", HEADER, rows)
    for o in failures:
        print(f"  {o.status}: {o.name}\n      residual {o.residual}, {o.steps} steps, {o.seconds:.1f} s: {o.reason}")
    found = {"machine": machine, "seed": arguments.seed, "cap_seconds": arguments.cap, "header": HEADER, "rows": rows}
    write_json("hanging_solids", {**found, "failures": [asdict(o) for o in failures]}, arguments.output)


if __name__ == "__main__":
    main()
