"""What a scene asks to be solved: one periodic solution, a frequency sweep, or wear over many cycles.

Sweeps, wear and what serves an accuracy are imported where a scene asks for them, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ewr_fenicsx.errors import EwrError, NotConverged
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.output.gathering import measure_thinnest_body
from ewr_fenicsx.output.output import check_own_fields, check_own_histories
from ewr_fenicsx.output.work_folder import refuse_other_work, take_up_model
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.runs import findings
from ewr_fenicsx.scene.scene import Scene
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solution.symmetry import leave_out_idle
from ewr_fenicsx.solver.newton import solve
from ewr_fenicsx.structure.chain import Chain, Progress, Stopwatch, spread_wear
from ewr_fenicsx.structure.reduction import keep_more_modes

if TYPE_CHECKING:
    from ewr_fenicsx.response.response_curve import FrequencyResponse
    from ewr_fenicsx.wear.wear import WearHistory

STABILITY = "stability"  # the stage that looks at it, and at all else that speaks against solutions
UNSEEN = "interrupted: nobody has looked at what speaks against it, such as its stability"
WEAR_FILE = "wear_{}.h5"  # by rank, in the folder of the work in progress


@dataclass(frozen=True)
class Study:
    """A scene solved.

    Attributes:
        chain: What it was solved on: the chain that was given, or one with as many modes as an accuracy took.
        solution: The one whose fields are written: the only one, a sweep's strongest, or the worn joint's.
        seconds: Time of each stage.
        curve: Of a sweep, frequencies and the rms of its first output (or J_T, or the work of the
            loads); of wear, cycles and mean worn depth, the volume over the area of all pairs.
        told: A few lines for people.
        write: Writes the study's own files into a folder; collective.
        facts: What decides whether to trust the run, for its summary: accuracy, breaks and gaps of a sweep, why wear
            stopped; ready for JSON.
        cut_short: What an interruption took from it, when the solution was there: "" as a rule.
    """

    chain: Chain
    solution: PeriodicSolution
    seconds: Mapping[str, float]
    curve: tuple[RealArray, RealArray] | None
    told: str
    write: Callable[[Path], None]
    facts: Mapping[str, object] = field(default_factory=dict)
    cut_short: str = ""


def can_resume(scene: Scene) -> bool:
    """Whether a scene's study goes on from where it was interrupted."""
    return len(scene.frequencies) > 1 or scene.wear is not None


def run_study(chain: Chain, progress: Progress | None = None, work: Path | None = None) -> Study:
    """Solves what the scene of a chain asks for; collective.

    Args:
        chain: What to solve on.
        progress: As in ``build_chain``.
        work: Folder of the work in progress, from which an interrupted study goes on, of a scene that can
            (``can_resume``); the caller's to remove (``keep_work``). None: nothing is kept.

    Raises:
        EwrError: As ``solve``, ``frequency_response`` and ``evolve_wear``.
        ModelError, OutputError: ``work`` holds another study; or, before any work, as ``check_own_fields`` and
            ``check_own_histories``.
        KeyboardInterrupt: Before there was a solution; or later, where ``work`` keeps it.
    """
    problem = chain.pose()
    check_own_fields(problem, wears=chain.scene.wear is not None)
    if problem.own_kinds:
        check_own_histories(problem)
    through, watch = measure_thinnest_body(chain), Stopwatch(progress)
    study = _solve(chain, watch, work, through)
    doubts = findings.doubt_small_motion(study.solution, chain.interface, through)
    lines, facts = [f"  NOT a small motion: {doubt}" for doubt in doubts], {"doubts_of_small_motion": doubts}
    cut_short = study.cut_short
    if chain.scene.solver.accuracy is None:
        own, facts["estimate"] = ["  its error is not known: interrupted"], None
        try:
            if not cut_short:
                with watch.stage("estimate"):
                    own, facts["estimate"] = _estimate(study)
        except KeyboardInterrupt:
            if work is not None:  # from which the same command goes on
                raise
            cut_short = "an estimate of their error"
        lines = [*own, *lines]
    told = "\n".join([study.told, *lines])
    facts = {**study.facts, **facts}
    return replace(study, seconds=watch.seconds, told=told, facts=facts, cut_short=cut_short)


def _estimate(study: Study) -> tuple[list[str], dict[str, float | None] | None]:
    """What is told of a study's estimated errors, and these themselves; None where nothing oscillates, or is known."""
    from ewr_fenicsx.accuracy.estimates import estimate_at_once

    chain, solution, what, rate = study.chain, study.solution, "the response", None
    if not solution.problem.frequency:
        return [], None
    if chain.scene.wear is not None:
        from ewr_fenicsx.wear.archard import weigh_wear_rate

        coefficient = spread_wear(chain.scene, chain.interface)
        pace = float(solution.problem.wear.max()) / chain.scene.wear.cycles
        what, rate = "the response and the wear rate", lambda there: weigh_wear_rate(there, coefficient, pace)
    try:
        estimate = estimate_at_once(solution, list_modes(chain), rate)
    except (EwrError, MemoryError) as error:  # the results are there, and not to be lost for it
        return [f"  its error is not known: {str(error) or 'out of memory'}"], None
    return [findings.tell_estimate(estimate, what)], findings.list_causes(estimate)


def _look_at(
    tell: Callable[[], str],
    watch: Stopwatch,
    work: Path | None,
    *solutions: PeriodicSolution,
    history: WearHistory | None = None,
) -> tuple[str, str]:
    """What is told of solutions, which are not lost where that takes too long; and what it then lacks."""
    try:
        with watch.stage(STABILITY):
            return tell(), ""
    except KeyboardInterrupt:
        if work is not None:  # from which the same command goes on
            raise
        for solution in solutions:
            vars(solution).update(cautions=(UNSEEN,), walks_slowly=None)
        if history is not None:
            vars(history)["loss_of_stability"] = None
        return tell(), "a look at what speaks against them"


def _solve(chain: Chain, watch: Stopwatch, work: Path | None, through: float) -> Study:
    scene = chain.scene
    if len(scene.frequencies) > 1:
        return _sweep(chain, watch, work)
    if scene.wear:
        return _wear(chain, watch, work, through)
    problem = chain.pose()
    if scene.solver.accuracy is not None and problem.frequency:
        return _solve_to_accuracy(chain, watch, problem)
    with watch.stage("solve"):
        solution = solve(problem, tolerance=scene.solver.tolerance)
    told, lacking = _look_at(solution.summary, watch, None, solution)
    return Study(chain, solution, watch.seconds, None, told, lambda folder: None, cut_short=lacking)


def _take_up(chain: Chain, work: Path | None, own: str) -> Chain:
    """The chain with the model that the work in a folder was begun with: files by the pattern ``own``."""
    if work is None:
        return chain
    model = take_up_model(work, chain.reduction.model, chain.mesh.domain.comm, own)
    return replace(chain, reduction=replace(chain.reduction, model=model))


def list_modes(chain: Chain) -> Sequence[int]:
    """Which coordinates of the reduced model are modal, and which static responses; and what full stick knows of more.

    Of a ring the frequencies of full stick are those of the reduced model.
    """
    from ewr_fenicsx.accuracy.modes_left_out import ModesBesideResponses

    reduction = chain.reduction
    stuck = () if reduction.cuts else reduction.full_stick.frequency
    return ModesBesideResponses(reduction.modal_coordinates, reduction.response_coordinates, stuck)


class _Modes:
    """A chain whose reduction is made anew, with more modes, as an accuracy takes them; collective."""

    def __init__(self, chain: Chain, watch: Stopwatch):
        self.chain, self.watch = chain, watch
        self.chains = [chain]

    def chain_of(self, solution: PeriodicSolution) -> Chain:
        """The chain on whose model a solution is: not the last one, where more modes led to none."""
        return next(chain for chain in self.chains if chain.reduction.model is solution.problem.model)

    @property
    def coordinates(self) -> Sequence[int]:
        """Which coordinates of the model are modal."""
        return list_modes(self.chain)

    @property
    def most(self) -> int:
        """How many modes may be kept; those that the scene states in any case."""
        from ewr_fenicsx.accuracy.accuracy import MOST_MODES

        return min(max(MOST_MODES, self.chain.scene.reduction.modes), self.chain.reduction.most_modes - 1)

    def keep_more(self, count: int) -> tuple[ContactProblem, Sequence[int]]:
        """The scene's problem on a model with so many modes, and which of its coordinates are modal.

        Wear may ask for the same again, where they led to no solution before.
        """
        made = {len(chain.reduction.modal_coordinates): chain for chain in self.chains}
        if count not in made:
            with self.watch.stage("more modes"):
                made[count] = replace(self.chains[-1], reduction=keep_more_modes(self.chains[-1].reduction, count))
            self.chains.append(made[count])
        self.chain = chain = made[count]
        return chain.pose(), self.coordinates

    @property
    def choice(self) -> dict[str, object]:
        """What ``solve_to_accuracy`` has to know of them."""
        return {"modes": self.coordinates, "more_modes": self.keep_more, "most_modes": self.most}


def _solve_to_accuracy(chain: Chain, watch: Stopwatch, problem: ContactProblem) -> Study:
    from ewr_fenicsx.accuracy.accuracy import solve_to_accuracy

    modes, asked = _Modes(chain, watch), chain.scene.solver
    with watch.stage("solve"):
        found = findings.word_remedy(
            solve_to_accuracy(problem, asked.accuracy, tolerance=asked.tolerance, **modes.choice)
        )
    told, lacking = _look_at(found.summary, watch, None, found.solution)
    chain, facts = modes.chain_of(found.solution), {"accuracy": findings.list_accuracy(found)}
    return Study(chain, found.solution, watch.seconds, None, told, lambda folder: None, facts, lacking)


def _sweep(chain: Chain, watch: Stopwatch, work: Path | None) -> Study:
    from ewr_fenicsx.response.frequency_sweep import frequency_response
    from ewr_fenicsx.response.sweep_store import FILES

    chain = _take_up(chain, work, FILES)
    scene, comm, problem = chain.scene, chain.mesh.domain.comm, chain.pose()
    settings = {key: getattr(problem, key) for key in ("samples", "rho_normal", "rho_tangential", "closure")}
    with watch.stage("sweep"), refuse_other_work(work):
        curve = frequency_response(
            problem.model,
            problem.laws,
            scene.frequencies,
            list(leave_out_idle(problem).basis.orders),  # no columns of zeros
            watch.progress is not None,
            tolerance=scene.solver.tolerance,
            work=work,
            comm=comm,
            **settings,
        )
        if scene.solver.accuracy is not None and curve.solutions:
            chain, curve = _refine(chain, watch, curve, work)
            curve = replace(curve, accurate=tuple(map(findings.word_remedy, curve.accurate)))
    if not curve.solutions:
        raise NotConverged(f"{scene.where}: no periodic solution at any of {len(scene.frequencies)} frequencies")
    with watch.stage(STABILITY):
        curve.look_at_stability(comm, watch.progress is not None, work)
    table = curve.table()
    outputs = [name for name in table if name.startswith("rms_")]
    shown = outputs or ["J_T" if "J_T" in table else "excitation_work"]  # nothing slides where all is bonded
    height = table[shown[0]]
    by_height = np.lexsort((height, ~curve.unstable))  # those that motions in time stay at come last
    strongest = curve.solutions[by_height[-1]]

    def write(folder: Path) -> None:
        from ewr_fenicsx.output.plots import draw_curves

        if comm.rank:
            return
        curve.write_csv(folder / "frequency_response.csv")
        draw_curves(
            folder / "frequency_response.png",
            "frequency [Hz]",
            curve.frequencies,
            dict(_label(name, table[name]) for name in shown),
            curve.breaks,
            curve.unstable,
        )

    beaten = height[by_height[-1]] < height.max()
    which = "strongest of those that motions in time stay at" if beaten else "strongest"
    if strongest.problem.frequency in (min(scene.frequencies), max(scene.frequencies)):
        which += ", at an end of the sweep, beyond which the peak may lie"
    told = "\n".join([*findings.tell_sweep(curve, problem), f"{which}: at {strongest.summary()}"])
    course, facts = (curve.frequencies, height), findings.list_facts_of_sweep(curve, problem)
    return Study(chain, strongest, watch.seconds, course, told, write, facts)


def _label(name: str, values: RealArray) -> tuple[str, RealArray]:
    return (f"{name} [J]", values) if name == "excitation_work" else (f"{name} [mm]", 1e3 * values)


def _refine(
    chain: Chain, watch: Stopwatch, curve: FrequencyResponse, work: Path | None
) -> tuple[Chain, FrequencyResponse]:
    """The curve with every solution as accurate as asked, and with as many modes as that takes at any of them."""
    from ewr_fenicsx.accuracy.accuracy import raise_modes
    from ewr_fenicsx.response.frequency_sweep import refine_response, thin_out

    curve = thin_out(curve, chain.scene.frequencies)
    asked, modes = chain.scene.solver, _Modes(chain, watch)
    problem = chain.pose()
    shown = watch.progress is not None
    while True:
        curve = refine_response(
            curve,
            problem,
            chain.scene.frequencies,
            asked.accuracy,
            asked.tolerance,
            modes=modes.coordinates,
            folder=work,
            comm=chain.mesh.domain.comm,
            progress=shown,
        )
        wanting = any(not found.reached and found.estimate.dominating == "modes" for found in curve.accurate)
        count = raise_modes(len(modes.coordinates), modes.most)
        if not wanting or count == len(modes.coordinates):
            return modes.chain, curve
        problem, _ = modes.keep_more(count)


def _wear(chain: Chain, watch: Stopwatch, work: Path | None, through: float) -> Study:
    from ewr_fenicsx.wear.cycle_jumps import Tolerance
    from ewr_fenicsx.wear.wear import evolve_wear

    chain = _take_up(chain, work, WEAR_FILE.format("*"))
    scene, interface = chain.scene, chain.interface
    asked, accuracy, modes = scene.wear, scene.solver.accuracy, _Modes(chain, watch)
    share = accuracy if asked.tolerance is None else asked.tolerance
    file = None if work is None else work / WEAR_FILE.format(chain.mesh.domain.comm.rank)  # every rank does all of it
    with watch.stage("wear"), refuse_other_work(work):
        history = evolve_wear(
            chain.pose(),
            asked.cycles,
            spread_wear(scene, interface),
            None if share is None else Tolerance(share=share),
            keep_every=max(1, asked.cycles // 100),
            deepest=through,
            file=file,
            tolerance=scene.solver.tolerance,
            accuracy=accuracy,
            progress=watch.progress is not None,
            **({} if accuracy is None else modes.choice),
        )
    history, chain = findings.word_stop(history), modes.chain_of(history.solutions[-1])

    def write(folder: Path) -> None:
        from ewr_fenicsx.output.plots import draw_curves
        from ewr_fenicsx.output.wear_fields import write_wear_fields

        write_wear_fields(folder, chain, history)
        if chain.mesh.domain.comm.rank:
            return
        history.write_csv(folder / "wear.csv")
        on_flank = {flank: interface.flank_of_pair == k for k, flank in enumerate(interface.flanks)}
        depths = {
            f"mean depth of {flank} [µm]": 1e6 * history.volume[:, mine].sum(axis=1) / interface.area[mine].sum()
            for flank, mine in on_flank.items()
        }
        depths["deepest pair [µm]"] = 1e6 * history.depth.max(axis=1)
        draw_curves(folder / "wear.png", "cycles", history.cycles, depths)

    last, count = history.solutions[-1], len(chain.reduction.modal_coordinates)

    def tell() -> str:
        return "\n".join([*findings.tell_wear(history, through, count), f"worn: {last.summary()}"])

    course = history.cycles, history.total_volume / interface.area.sum()
    told, lacking = _look_at(tell, watch, work, history.solutions[0], last, history=history)  # unworn and worn
    return Study(chain, last, watch.seconds, course, told, write, findings.list_facts_of_wear(history), lacking)
