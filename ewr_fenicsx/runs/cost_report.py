"""``ewr cost``: what each knob of a scene's contact solve costs and buys, and the cheapest setting for an accuracy."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory

from ewr_fenicsx.accuracy.cost import HIGHEST as SEEN
from ewr_fenicsx.accuracy.cost import Figures, choose_cheapest, compare_figures, list_settings, measure_figures, survey
from ewr_fenicsx.accuracy.estimates import estimate_errors
from ewr_fenicsx.errors import SceneError
from ewr_fenicsx.output.output import write_results
from ewr_fenicsx.output.result_folder import do_with_files, read_summary
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.problem.dashpots import use_mobility
from ewr_fenicsx.progress import count_progress
from ewr_fenicsx.runs.study import STABILITY
from ewr_fenicsx.solver.newton import solve
from ewr_fenicsx.solver.weights import use_default_weights
from ewr_fenicsx.structure.chain import Chain, Stopwatch

ORDERS = (1, 2, 3, 5, 7, 9, 12, 15, 19, 23)
HIGHEST, MOST_UNKNOWNS = 31, 3000  # of the reference
LEVELS = (0.1, 0.01, 0.001)
STEPS = (400, 800)  # a period, of time stepping
TABLE, PICTURE = "cost.json", "cost.png"
TITLES = {"output": "response (amplitude and phase)", "wear": "wear a cycle", "normal forces": "normal forces"}


@dataclass(frozen=True, eq=False)
class CostReport:
    """A survey of a scene: rows as of ``survey``, how far its reference can be trusted, and a few lines for people.

    ``title`` names the scene. ``stages`` are the seconds of a run by stage: the chain, one solve with the scene's
    harmonics at its first frequency, and writing its results.
    """

    title: str
    rows: list[dict]
    reference: str
    own_error: float
    told: str
    stages: dict[str, float]

    def write(self, folder: Path) -> list[Path]:
        """Writes ``cost.json`` and ``cost.png`` into a folder."""
        from ewr_fenicsx.output.cost_plots import draw_work_precision

        folder.mkdir(parents=True, exist_ok=True)
        files = [folder / TABLE, folder / PICTURE]
        content = {"reference": self.reference, "own_error": self.own_error, "stages": self.stages, "rows": self.rows}
        files[0].write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        draw_work_precision(files[1], self.rows, TITLES, f"{self.title}\nreference: {self.reference}")
        return files


def survey_scene(chain: Chain, against_time_stepping: bool = False, progress: bool = False) -> CostReport:
    """Turns the knobs of a scene's contact solve, one at a time, at its first frequency.

    Args:
        chain: The scene's chain.
        against_time_stepping: Whether the reference is time stepping, which takes longer but shares no code with what
            it judges; else a harmonic solve with many harmonics.
        progress: Whether to show on standard error what is done and how long the rest will take.

    Raises:
        SceneError: Nothing oscillates, so that there is nothing to choose; a sector of a ring, against time stepping.
    """
    ring = chain.reduction.model.cyclic
    if against_time_stepping and ring:
        raise SceneError(f"{chain.scene.where}: a sector of a ring is not stepped in time; leave out --time-stepping")
    problem = chain.pose()
    loaded = [h for h in problem.driven if h]
    if not loaded or not problem.frequency:
        raise SceneError(f"{chain.scene.where}: no load oscillates: one static solve, exact with any setting")
    problem = replace(use_default_weights(problem), samples=None)
    with count_progress("reference", 1, progress) as tell:
        find = partial(step_reference, progress=progress) if against_time_stepping else solve_reference
        reference, own, name, highest = find(problem, max(loaded))
        tell(1)
    orders = [n for n in ORDERS if n < 0.7 * highest]
    settings = list_settings(problem, orders, fixed=max(min(9, highest // 3), max(loaded)))
    with count_progress("settings", len(settings), progress) as tell:
        done = count(1)
        rows = survey(settings, reference, repeats=1, report=lambda _: tell(next(done)))
    several = len(chain.scene.frequencies)
    told = [
        f"at {problem.frequency:g} Hz" + (f", the first of the sweep's {several} frequencies" if several > 1 else "")
    ]
    told += [f"reference: {name}; its own error is estimated at {own:.1g} of the response, other figures may be worse"]
    for level in LEVELS:  # the reference may err by its own error to either side
        best = choose_cheapest([row for row in rows if row["knob"].startswith("N")], "output", level - own)
        if best is not None:
            told.append(f"  {level:>6.1%}: {_tell(best)}")
        elif own > level / 2:
            better = "" if against_time_stepping or ring else "; --time-stepping is a better one"
            told.append(f"  {level:>6.1%}: the reference is not good enough to tell{better}")
        else:
            told.append(f"  {level:>6.1%}: none of the settings tried")
    stages = time_run(chain)
    asked = {"sweep": several > 1, "wear": chain.scene.wear, "accuracy": chain.scene.solver.accuracy}
    aside = " and ".join(name for name, there in asked.items() if there)
    timed = f"stages of a run without its {aside}" if aside else "stages of a run"
    told.append(f"{timed}: " + ", ".join(f"{stage} {t:.2f} s" for stage, t in stages.items()))
    title = chain.scene.title or chain.scene.geometry.source.stem
    return CostReport(title, rows, name, own, "\n".join(told), stages)


def time_run(chain: Chain) -> dict[str, float]:
    """Seconds of a run by stage: the chain as it was built, one solve, and writing results, which are thrown away."""
    problem = chain.pose()
    solution = solve(problem, tolerance=chain.scene.solver.tolerance)
    newton, watch = {f"solve: {stage}": seconds for stage, seconds in solution.stages.items()}, Stopwatch()
    with watch.stage(STABILITY):
        solution.summary()
    comm = chain.mesh.domain.comm
    with TemporaryDirectory() as own:
        folder = Path(comm.bcast(own)) / "run"
        write_results(folder, chain, solution, seconds=newton | watch.seconds)
        return do_with_files(lambda: read_summary(folder)["seconds"], comm)


def solve_reference(problem: ContactProblem, loaded: int) -> tuple[Figures, float, str, int]:
    """Figures of a harmonic solve of high order, its estimated error, its name and its highest harmonic."""
    highest = max(2 * loaded + 2, min(HIGHEST, MOST_UNKNOWNS // (2 * max(1, problem.system.rows.shape[0]))))
    solution = solve(use_mobility(replace(problem, harmonics=highest)))
    return measure_figures(solution), estimate_errors(solution).total, f"harmonic balance, N = {highest}", highest


def step_reference(problem: ContactProblem, loaded: int, progress: bool = False) -> tuple[Figures, float, str, int]:
    """Figures of the steady state of time stepping, their change with the last halving of the step, name, and 31.

    ``progress``: whether to show the periods stepped so far.
    """
    from ewr_fenicsx.solver.time_integration import integrate

    start, found = solve(replace(problem, harmonics=max(9, 2 * loaded))), []
    for steps in STEPS:
        posed = replace(problem, harmonics=min(SEEN, (steps - 1) // 2))
        steady = integrate(posed, start, steps, 200, 1e-5, acceleration=True, progress=progress)
        start = steady.end
        found.append(measure_figures(steady))
    own = compare_figures(found[0], found[1])["output"] / 3  # the scheme is of second order
    output = found[1].output + (found[1].output - found[0].output) / 3
    name = f"time stepping, {STEPS[-1]} steps a period" + ("" if steady.converged else f", {steady.reason}")
    return replace(found[1], output=output), own, name, HIGHEST


def _tell(row: dict) -> str:
    error, size = row["errors"]["output"], row["unknowns"]
    return f"{row['knob']} = {row['value']:g}: {error:.1e}, {size} unknowns, {row['seconds']:.2f} s"
