"""The command ``ewr``: solve a scene, or tell what it holds.

Exit codes: 0 done, 2 something that the user can mend (one message, no traceback), 3 no periodic solution found,
130 interrupted, by Ctrl-C or a job scheduler.
Heavy imports wait until the scene has been read, so that help and mistakes in scenes come at once.
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from errno import EDQUOT, ENOSPC
from os.path import expanduser
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ewr_fenicsx import __version__
from ewr_fenicsx.display import add_line, note_log, share_display
from ewr_fenicsx.errors import EwrError, OptionError, UnheldBody
from ewr_fenicsx.runs.start import settle_streams, start_petsc
from ewr_fenicsx.scene.scene import Scene, load_scene

if TYPE_CHECKING:
    from mpi4py import MPI

    from ewr_fenicsx.problem.contact_problem import ContactProblem
    from ewr_fenicsx.runs.cost_report import CostReport
    from ewr_fenicsx.scene.effects import Effect
    from ewr_fenicsx.structure.chain import Chain
    from ewr_fenicsx.structure.interface import Interface

# How long a failed rank waits for the others to fail as well before it stops them [s]
PATIENCE = 2.0
INTERRUPTED = 130  # exit code
NO_ROOM = (ENOSPC, EDQUOT)  # what the system says of a full disk


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line and returns its exit code."""
    with settle_streams():
        return _run_command(argv)


def _run_command(argv: Sequence[str] | None) -> int:
    arguments, petsc_options = parse_arguments(argv)
    try:
        start_petsc(petsc_options)  # before anything else imports it
    except OptionError as error:  # on all ranks
        print(f"ewr: {error}", file=sys.stderr)
        return error.exit_code
    from mpi4py import MPI

    # in place of PETSc's own, which abort with a page of advice on debugging
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # job schedulers end a run so: the same as Ctrl-C
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # "ewr info SCENE | head" has read enough
    comm = MPI.COMM_WORLD
    return stop_together(comm, lambda: COMMANDS[arguments.command](arguments, comm))


def parse_arguments(argv: Sequence[str] | None) -> tuple[argparse.Namespace, list[str]]:
    """Arguments of ``ewr``, and those left for PETSc: unknown ones with a single dash, after the scene."""
    parser = argparse.ArgumentParser(
        prog="ewr",
        description="Contact, friction and wear in vibrating joints, by harmonic balance.",
        epilog="ewr COMMAND --help tells more. Exit codes: 0 done, 2 something that you can mend, 3 no solution found, "
        "130 interrupted.",
    )
    parser.add_argument("--version", action="version", version=f"ewr_fenicsx {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    run = commands.add_parser(
        "run",
        help="solve a scene and write its results",
        description="Solve a scene and write files, fields and pictures. Begin an interrupted sweep or wear run again "
        "with the same command: it goes on from where it was.",
        epilog="Options with a single dash after the scene go to PETSc, e.g. -ewr_snes_monitor.",
        allow_abbrev=False,
    )
    run.add_argument("scene", type=Path, metavar="SCENE", help="scene file (.toml); docs/scenes.md lists its keys")
    run.add_argument("--out", type=Path, metavar="DIR", help="result folder; by default results/NAME beside the scene")
    run.add_argument("--overwrite", action="store_true", help="replace an earlier result folder")
    info = commands.add_parser(
        "info",
        help="check a scene and print what it holds, without solving it",
        description="Check a scene and print counts, and which effects it has, why, and what they cost.",
        allow_abbrev=False,
    )
    info.add_argument("scene", type=Path, metavar="SCENE", help="scene file (.toml)")
    info.add_argument("--out", type=Path, metavar="DIR", help="result folder of an earlier run, for its times")
    cost = commands.add_parser(
        "cost",
        help="what accuracy costs: vary the solver's settings one at a time",
        description="Error and time of many settings of the solver (harmonics, samples, weights, tolerance), one "
        "varied at a time, against a finer solution.",
        allow_abbrev=False,
    )
    cost.add_argument("scene", type=Path, metavar="SCENE", help="scene file (.toml)")
    where = "folder of the table and the picture; by default results/NAME_cost beside the scene"
    cost.add_argument("--out", type=Path, metavar="DIR", help=where)
    cost.add_argument("--overwrite", action="store_true", help="replace the table and picture of an earlier survey")
    reference = "take time stepping as the reference: slower, but independent"
    cost.add_argument("--time-stepping", action="store_true", help=reference)
    arguments, rest = parser.parse_known_args(argv)
    if arguments.out is not None:
        arguments.out = Path(expanduser(arguments.out))  # not every shell does, after an equals sign
    for given in sys.argv[1:] if argv is None else argv:
        if given.encode(errors="ignore").decode() != given:
            commands.choices[arguments.command].error(f"{given!r} is not UTF-8, as dolfinx wants it; rename it")
    own = [name.replace("_", "-") for name in vars(arguments) if name not in ("command", "scene")]
    for option in rest:  # PETSc takes whatever it is given, and says nothing
        if option.startswith("-") and (meant := get_close_matches(option.strip("-").partition("=")[0], own, 1, 0.8)):
            commands.choices[arguments.command].error(f"unknown argument: {option}; was --{meant[0]} meant?")
    if rest and (arguments.command != "run" or not rest[0].startswith("-") or any(a.startswith("--") for a in rest)):
        commands.choices[arguments.command].error(
            f"unknown argument: {next((a for a in rest if a.startswith('--')), rest[0])}"
        )
    return arguments, rest


def run_scene(arguments: argparse.Namespace, comm: MPI.Comm) -> int:
    """``ewr run``: from the scene to a result folder."""
    scene, folder = read_scene(arguments, comm)
    from ewr_fenicsx.output.output import list_files, write_results
    from ewr_fenicsx.output.result_folder import hold_target
    from ewr_fenicsx.output.work_folder import holds_work, keep_work, name_work_folder
    from ewr_fenicsx.runs.study import can_resume, run_study
    from ewr_fenicsx.structure.chain import Stopwatch, build_chain

    work, overwrite = name_work_folder(folder) if can_resume(scene) else None, arguments.overwrite
    with hold_target(folder, overwrite=overwrite, comm=comm), keep_work(work, comm), show_progress(comm) as progress:
        if work and holds_work(work, comm) and comm.rank == 0:
            print(f"ewr: found interrupted work in {work}", file=sys.stderr, flush=True)
        chain = build_chain(scene, comm, progress)
        tell_doubts(scene, chain.doubts, comm)
        with name_place(scene, chain.interface):
            study = run_study(chain, progress, work)
        with Stopwatch(progress).stage("write"):
            files = write_results(
                folder,
                study.chain,
                study.solution,
                overwrite=overwrite,
                seconds=study.seconds,
                write_more=study.write,
                facts=study.facts,
            )
    if comm.rank == 0:
        tell_unused_options()
        print(study.told, list_files(files), sep="\n\n", flush=True)
    if study.cut_short:
        raise KeyboardInterrupt(f"the results are in {folder}, without {study.cut_short}")
    return 0


def tell_unused_options() -> None:
    """Names options that were meant for PETSc's solvers and that none took, which PETSc passes over in silence."""
    from ewr_fenicsx.structure._compat import list_unused_options

    for name in list_unused_options():
        if name.startswith("ewr_"):
            print(f"ewr: nothing took -{name}: is it spelt so? Linear scenes take none", file=sys.stderr)
        elif name.startswith(("snes_", "ksp_", "pc_")):
            print(f"ewr: nothing took -{name}; was -ewr_{name} meant?", file=sys.stderr)


def describe_scene(arguments: argparse.Namespace, comm: MPI.Comm) -> int:
    """``ewr info``: counts and effects, without solving."""
    scene, folder = read_scene(arguments, comm)
    from ewr_fenicsx.output.result_folder import read_times
    from ewr_fenicsx.scene.effects import list_effects
    from ewr_fenicsx.structure.chain import build_chain

    with show_progress(comm) as progress:
        chain = build_chain(scene, comm, progress)
        tell_doubts(scene, chain.doubts, comm)
    with name_place(scene, chain.interface):
        problem = chain.pose()
        counts = count(chain, problem)  # the mesh counts are collective
        seconds = read_times(folder, scene.model_dump(mode="json", by_alias=True))
        effects = list(list_effects(scene, problem, seconds, chain.interface.flanks))
    if comm.rank == 0:
        console = Console(highlight=False, width=None if sys.stdout.isatty() else 160)  # a file has no width to wrap to
        console.print(scene.title or str(arguments.scene), style="bold", markup=False)
        table = Table("", "", show_header=False, box=None, pad_edge=False)
        for name, value in counts.items():
            table.add_row(name, value)
        console.print(table)
        console.print()
        console.print(tabulate_effects(effects))
        if seconds:
            stages = ", ".join(f"{stage} {t:.2f} s" for stage, t in seconds.items())
            console.print(f"last run, {folder}: {stages}; laws share the solve by their unknowns", soft_wrap=True)
        elif arguments.out:
            print(f"ewr: warning: {folder} holds no run of this scene as it is; no times", file=sys.stderr, flush=True)
    return 0


def tell_costs(arguments: argparse.Namespace, comm: MPI.Comm) -> int:
    """``ewr cost``: error and time of each setting, on one rank's processor."""
    scene, folder = read_scene(arguments, comm)
    from ewr_fenicsx.output.result_folder import hold_target
    from ewr_fenicsx.runs.cost_report import PICTURE, TABLE, survey_scene
    from ewr_fenicsx.structure.chain import build_chain

    folder = arguments.out or folder.with_name(f"{folder.name}_cost")
    with hold_target(folder, overwrite=arguments.overwrite, comm=comm, own=(TABLE, PICTURE)):
        with show_progress(comm) as progress:
            chain = build_chain(scene, comm, progress)
            tell_doubts(scene, chain.doubts, comm)
        with name_place(scene, chain.interface):
            report = survey_scene(chain, arguments.time_stepping, progress=comm.rank == 0)
        if comm.rank == 0:
            print_costs(report)
            print(report.told, flush=True)  # before anything that drawing may stumble over
            print(*report.write(folder), sep="\n", flush=True)
    return 0


def print_costs(report: CostReport) -> None:
    """Table of what each setting costs."""
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 180)
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("knob", no_wrap=True)
    for header in ("value", "unknowns", "steps", "s", *report.rows[0]["errors"]):
        table.add_column(header.replace(" ", "\n"), justify="right")
    for row in report.rows:
        cells = [f"{row['value']:g}", str(row["unknowns"]), str(row["steps"]), f"{row['seconds']:.3f}"]
        errors = [f"{error:.1e}" for error in row["errors"].values()] if row["converged"] else ["not found"]
        table.add_row(escape(row["knob"]), *cells, *errors)
    console.print(
        "relative errors; output: amplitude and phase of the outputs, or of the contact if there are none\n"
        "steps: of Newton; s: processor time\n"
        'N: highest harmonic; springs: closure = "spring"; by mobility: rho_T as an accuracy chooses it'
    )
    needed = console.measure(table, options=console.options.update(width=1000)).maximum
    console.width = max(console.width, needed)  # a narrow terminal, as that of mpirun, breaks lines and cuts no number
    console.print(table)


def read_scene(arguments: argparse.Namespace, comm: MPI.Comm) -> tuple[Scene, Path]:
    """The scene, its doubts told on standard error, and the folder of its results; then PETSc's options are checked."""
    scene = load_scene(arguments.scene, warn=False)
    tell_doubts(scene, scene.doubts, comm)
    from ewr_fenicsx.runs.petsc_options import check_options

    check_options()
    return scene, arguments.out or arguments.scene.parent / "results" / arguments.scene.stem


def tell_doubts(scene: Scene, doubts: Sequence[str], comm: MPI.Comm) -> None:
    """What is probably not meant, on standard error of rank 0."""
    for doubt in doubts if comm.rank == 0 else ():
        print(f"ewr: warning: {scene.where}: {doubt}", file=sys.stderr, flush=True)


def count(chain: Chain, problem: ContactProblem) -> dict[str, str]:
    """What a chain holds, name -> figure."""
    from ewr_fenicsx.balance.balance import HarmonicBalance
    from ewr_fenicsx.scene.effects import leaves_choice
    from ewr_fenicsx.solution.symmetry import leave_out_idle

    reduction, interface = chain.reduction, chain.interface
    pairs = [f"{flank} {int((interface.flank_of_pair == k).sum())}" for k, flank in enumerate(interface.flanks)]
    quality, modes = chain.mesh.smallest_scaled_jacobian, reduction.fixed_interface_frequencies
    orders = ", ".join(map(str, problem.basis.orders))
    system = leave_out_idle(problem).system
    unknowns = HarmonicBalance(system).size if system.laws else 0
    waves = f"{orders} of {problem.frequency:g} Hz, {problem.basis.samples} samples"
    counted, kept = f"{unknowns} of the contact solve", f"{len(modes)} fixed-interface modes"
    if leaves_choice(chain.scene):
        asked = f"chosen by the solver for accuracy = {chain.scene.solver.accuracy:g}"
        waves, counted, kept = f"{asked}, at {problem.frequency:g} Hz", asked, f"{kept} to begin with,"
    return {
        "nodes": f"{chain.structure.space.dofmap.index_map.size_global}",
        "cells": f"{chain.mesh.cells}, smallest scaled Jacobian {quality:.2f}",
        "pairs": f"{len(interface.area)} ({', '.join(pairs)})",
        "modes": f"{kept} up to {max(modes):.0f} Hz",
        "first full-stick mode": (
            f"{reduction.full_stick.frequency[0]:.1f} Hz{reduction.model.tell_wave()}, damped by "
            f"{reduction.full_stick_ratio:.2%} of the critical"
        ),
        "coordinates": f"{reduction.model.size}, {reduction.model.rigid_modes.shape[1]} rigid-body modes",
        "harmonics": waves,
        "unknowns": counted,
    }


def tabulate_effects(effects: Sequence[Effect]) -> Table:
    """Table of the effects of a scene: on or off, why, and what each costs."""
    table = Table("effect", "", "why", box=None, pad_edge=False, header_style="bold")
    for header in ("unknowns", "rows", "last run"):
        table.add_column(header, justify="right")
    for effect in effects:
        costs = [str(cost) if cost else "" for cost in (effect.unknowns, effect.rows)]
        share = "" if effect.share is None else f"{effect.share:.1%}"
        state = "on" if effect.on else "off"
        table.add_row(effect.name, state, escape(effect.why), *costs, share, style=None if effect.on else "dim")
    return table


COMMANDS = {"run": run_scene, "info": describe_scene, "cost": tell_costs}


@contextmanager
def name_place(scene: Scene, interface: Interface) -> Iterator[None]:
    """Adds to a message on an unheld body what the contact problem does not know: scene file and flanks.

    Raises:
        UnheldBody: With the longer message.
    """
    try:
        yield
    except UnheldBody as error:
        flanks = sorted({interface.flanks[interface.flank_of_pair[pair]] for pair in error.pairs})
        place = f" (those pairs are on {', '.join(flanks)})" if flanks else ""
        raise UnheldBody(f"{scene.where}: {error}{place}", error.pairs) from error


@contextmanager
def show_progress(comm: MPI.Comm) -> Iterator[Callable[[str, float | None], None] | None]:
    """Stages on standard error of rank 0: live on a terminal, one plain line each elsewhere; nothing on other ranks."""
    console = Console(stderr=True, highlight=False)
    if comm.rank != 0:
        yield None
    elif not console.is_terminal:
        yield lambda stage, seconds: None if seconds is None else console.print(f"{stage:<12}{seconds:8.2f} s")
    else:
        with share_display() as display, note_log(display):
            lines = {}

            def progress(stage: str, seconds: float | None) -> None:
                if seconds is None:
                    lines[stage] = add_line(display, stage)
                else:
                    display.update(lines[stage], completed=1, note="")

            yield progress


def stop_together(comm: MPI.Comm, action: Callable[[], int]) -> int:
    """Runs ``action`` on all ranks; a failure on any of them ends all of them, with one message.

    Returns:
        The action's exit code, or that of its error. Does not return where other ranks still wait for this one.
    """
    errors = comm.Dup()  # messages about failures must not meet those of the work
    try:
        return action()
    except EwrError as error:
        message, code = f"ewr: {error}", error.exit_code
    except MemoryError as error:
        message = f"ewr: out of memory: {error}; take a larger mesh_size, or fewer pairs, modes or harmonics"
        code = EwrError.exit_code
    except KeyboardInterrupt as stop:
        message, code = "; ".join(["ewr: interrupted", *map(str, stop.args)]), INTERRUPTED
    except Exception as error:
        if _was_interrupted(error):
            message, code = "ewr: interrupted", INTERRUPTED
        elif isinstance(error, OSError) and error.errno in NO_ROOM:
            message = f"ewr: {error.filename or 'the output'} cannot be written: {error.strerror}; make room"
            code = EwrError.exit_code
        elif comm.size == 1:
            raise
        else:
            message, code = traceback.format_exc(), 1
    together = everyone_failed(errors)
    if code == INTERRUPTED and not together:
        message += f" (rank {comm.rank}, by a signal or since another rank failed)"
    if comm.rank == 0 or not together:
        print(message, file=sys.stderr, flush=True)
    if not together:
        comm.Abort(code)
    return code


def _was_interrupted(error: BaseException) -> bool:
    """Whether Ctrl-C is behind an error: a compiled module that was being imported makes another one of it."""
    return isinstance(error.__cause__, KeyboardInterrupt)


def everyone_failed(comm: MPI.Comm) -> bool:
    """Whether all ranks call this within a short time; lower ranks give up first, so that one speaks for all."""
    request = comm.Ibarrier()
    deadline = time.monotonic() + PATIENCE + 0.5 * comm.rank
    while not request.Test():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True
