"""Result folders: fields for ParaView, the reduced model, a table of the pairs, and how all of it came about.

Fields are XDMF time series over one period, one field a file, at the nodes of the mesh, which ParaView animates.
"""

from __future__ import annotations

import errno
import json
import os
import platform
import resource
import shutil
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path

import dolfinx
import h5py
import numpy as np

from ewr_fenicsx.balance.periodic_motion import HISTORIES, SECOND, SECOND_HISTORIES, PeriodicMotion
from ewr_fenicsx.errors import OutputError
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.output import mesh_plots, plots, solid_plots
from ewr_fenicsx.output.gathering import node_interpolation
from ewr_fenicsx.output.pair_fields import spread_over_interface
from ewr_fenicsx.output.result_folder import SUMMARY, do_with_files, read_summary, result_folder
from ewr_fenicsx.output.ring_plots import draw_diameters, find_waves, gather_ring, tell_ring, write_diameters
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.solution.contact_state import changes_state, classify_contact, list_figures, list_histories
from ewr_fenicsx.solution.indicators import measure_sliding
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.structure import _compat
from ewr_fenicsx.structure.chain import JIT, Chain, add_times
from ewr_fenicsx.structure.interface import Interface
from ewr_fenicsx.whole_files import write_table

STEPS = 32  # instants of the period in the field files
SAMPLES = 1024  # samples of the period behind the table of pairs
NUMBER, A_CORNER, A_FILE = 8, 4, 2**16  # bytes; numbers that cells may take a corner, and bytes of a file besides
AWAY_FROM_CONTACT = -1.0  # contact_state of nodes that belong to no pair
FIELDS = ("displacement", "contact_pressure", "friction_traction", "contact_state", "mesh_tags")  # but histories
FIELDS_OF_WEAR = ("worn_depth", "worn_gap", "mean_pressure", "sliding_distance", "J_T", "worn_surface")
PACKAGES = (
    "numpy",
    "scipy",
    "petsc4py",
    "slepc4py",
    "mpi4py",
    "dolfinx",
    "basix",
    "ufl",
    "gmsh",
    "h5py",
    "pydantic",
    "matplotlib",
)


def write_results(
    folder: Path,
    chain: Chain,
    solution: PeriodicSolution,
    *,
    overwrite: bool = False,
    seconds: Mapping[str, float] | None = None,
    write_more: Callable[[Path], None] | None = None,
    facts: Mapping[str, object] | None = None,
) -> tuple[Path, ...]:
    """Writes everything that there is to say of a solution.

    Args:
        folder: Where to; it must not exist, unless ``overwrite``.
        chain: The scene and what was built of it.
        solution: Its periodic solution.
        overwrite: Whether an earlier result folder may be replaced.
        seconds: Time of the stages after the chain; None: that of the one solve.
        write_more: Writes further files into the folder it is given; called on every rank.
        facts: Further entries of the summary, ready for JSON.

    Returns:
        The files written, in ``folder``. The same on every rank.

    Raises:
        OutputError: The folder is taken, or cannot be written; or as ``check_own_fields``.
    """
    check_own_fields(solution.problem, wears=chain.scene.wear is not None)
    comm, start = chain.mesh.domain.comm, time.perf_counter()
    compiled = _compat.measure_compilation()
    with result_folder(folder, overwrite=overwrite, comm=comm) as draft:
        write_fields(draft, chain, solution)
        pictures = mesh_plots if chain.mesh.dimension == 2 else solid_plots
        pictures.draw_mesh(draft / "mesh.png", chain)
        pictures.draw_motion(draft / "full_stick_mode.png", mesh_plots.gather_mode(chain), mesh_plots.tell_mode(chain))
        if solution.problem.model.cyclic and np.any(solution.coordinates[np.array(solution.orders) > 0]):
            pictures.draw_motion(draft / "ring.png", gather_ring(chain, solution), tell_ring(chain, solution))
        if write_more:
            write_more(draft)
        memory = comm.gather(measure_memory(), root=0)
        if comm.rank == 0:
            plots.draw_histories(draft / "pair_histories.png", chain.interface, solution)
            plots.draw_contact_sets(draft / "contact_sets.png", chain.interface, solution)
            chain.reduction.model.save(draft / "reduced_model.h5")
            write_pairs(draft / "pairs.csv", chain.interface, solution)
            if (sector := chain.reduction.model).cyclic:
                waves = find_waves(sector)
                write_diameters(draft / "nodal_diameters.csv", waves)
                draw_diameters(draft / "nodal_diameters.png", waves, sector, chain.scene.frequencies)
            files = sorted([path.name for path in draft.iterdir()] + [SUMMARY])
            summary = summarise(chain, solution) | dict(facts or {}) | {"peak_memory_MB": memory, "files": files}
            compiled = _compat.measure_compilation() - compiled
            own = {JIT: compiled, "write": time.perf_counter() - start - compiled}
            summary["seconds"] = add_times(chain.seconds, seconds or {"solve": solution.seconds}, own)
            (draft / SUMMARY).write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    return tuple(folder / name for name in do_with_files(lambda: read_summary(folder)["files"], comm))


def check_own_fields(problem: ContactProblem, *, wears: bool) -> None:
    """Checks that what laws report can go to files of its own.

    Args:
        problem: Whose laws.
        wears: Whether there are fields over the cycles as well.

    Raises:
        OutputError: Other files have that name, or none can have it.
    """
    taken = FIELDS + FIELDS_OF_WEAR * (wears or problem.wear is not None)
    for _, laws in problem.groups:
        for kind in laws.kinds:
            for name in kind.histories:
                impossible = "/" in name or not name.strip(".")
                if impossible or name.removeprefix(SECOND) in taken:
                    why = "no file can have" if impossible else "result folders have a file of"
                    raise OutputError(f'{type(kind).__name__}.histories: "{name}": {why} that name; give another')


def check_own_histories(problem: ContactProblem) -> None:
    """Checks that laws report what their kinds say, before any contact force is there.

    Raises:
        ModelError: A kind names a history that none of its laws reports.
    """
    system = problem.system
    nothing = np.zeros((len(problem.basis.orders), len(system.rows)), dtype=complex)
    apart = PeriodicMotion(problem, nothing, np.zeros(system.compliance.rigid_motion.shape[1]))
    with np.errstate(all="ignore"):  # laws may divide by forces
        for name in apart.histories:
            if name not in HISTORIES + SECOND_HISTORIES:
                apart.history(name, problem.basis.samples)


def list_files(files: Sequence[Path]) -> str:
    """Files and pictures of a run, for people; an HDF5 file that belongs to an XDMF file goes without saying."""
    companions = {path.with_suffix(".h5") for path in files if path.suffix == ".xdmf"}
    pictures = [path for path in files if path.suffix == ".png"]
    others = [path for path in files if path.suffix != ".png" and path not in companions]
    return "\n".join(["files:", *(f"  {path}" for path in others), "pictures:", *(f"  {path}" for path in pictures)])


def write_fields(folder: Path, chain: Chain, solution: PeriodicSolution) -> None:
    """Writes XDMF time series over one period, one field a file, and the mesh tags; collective.

    Instants are equidistant; the end of the period, its beginning again, is left out. At rest there is one.

    Args:
        folder: Where to.
        chain: Mesh, interface and reduction basis.
        solution: On the reduced model of ``chain``.
    """
    domain, interface = chain.mesh.domain, chain.interface
    steps = STEPS if np.any(solution.coordinates[np.array(solution.orders) > 0]) else 1
    times = np.arange(steps) / (steps * (solution.problem.frequency or 1.0))
    phase = np.exp(2j * np.pi * np.outer(np.arange(steps), solution.orders) / steps)
    ring, orders = solution.problem.model.cyclic, solution.orders
    lags = np.array([ring.lag(ring.wave_of(h)) if ring else 1.0 for h in orders])
    own, following = ((phase * lag @ solution.coordinates).real for lag in (1.0, lags))
    to_nodes = node_interpolation(chain.structure.space)
    frames = (to_nodes(chain.reduction.expand(*x)) for x in zip(own, following, strict=True))
    write_series(folder / "displacement.xdmf", domain, times, frames)
    of_before = _look_at_sector_before(interface, solution, steps)
    for name, values in contact_fields(interface, solution, steps).items():
        spread = spread_over_interface(chain, AWAY_FROM_CONTACT if name == "contact_state" else 0.0)
        write_series(folder / f"{name}.xdmf", domain, times, map(spread, values, of_before.get(name, values)))
        if name == "contact_state":
            domain.comm.barrier()
            do_with_files(lambda: _round_series(folder / "contact_state.h5"), domain.comm, folder)
    with _open_xdmf(folder / "mesh_tags.xdmf", domain) as file:
        for name, tags in (("bodies", chain.mesh.cell_tags), ("boundaries", chain.mesh.facet_tags)):
            tags.name = name
            domain.topology.create_connectivity(tags.dim, domain.topology.dim)
            _compat.write_meshtags(file, tags, domain)


def _look_at_sector_before(interface: Interface, solution: PeriodicSolution, steps: int) -> dict[str, RealArray]:
    """``contact_fields`` of the sector before, which is ahead in time; of no ring that touches, or at rest, nothing."""
    if steps == 1 or not np.any(interface.is_next):
        return {}
    ring = solution.problem.model.cyclic
    often = contact_fields(interface, solution, steps * ring.sectors)
    return {name: np.roll(v, -ring.engine_order * steps, axis=0)[:: ring.sectors] for name, v in often.items()}


def contact_fields(interface: Interface, solution: PeriodicSolution, samples: int) -> dict[str, RealArray]:
    """What happens at the pairs, as far as the laws know of it: name -> ``(samples, K_c)``.

    Pressure and traction [Pa] are the truncated forces that balance the loads over the tributary area;
    ``friction_traction`` acts on body A along the pair's tangent, ``second_...`` along its second one in 3-D. Gap and
    slip in m.
    ``contact_state``: 0 open, 1 stick, 2 slip.
    """
    fields = {}
    for name, history, divisor in (
        ("contact_pressure", "normal_force", interface.area),
        ("friction_traction", "friction_force", interface.area),
        ("gap", "gap", 1.0),
        ("slip", "slip", 1.0),
        (SECOND + "friction_traction", SECOND + "friction_force", interface.area),
        (SECOND + "slip", SECOND + "slip", 1.0),
    ):
        if history in list_histories(solution):
            fields[name] = solution.history(history, samples) / divisor
    for name in list_histories(solution):
        if name not in HISTORIES + SECOND_HISTORIES:  # a law of the user's own
            fields[name] = solution.history(name, samples)
    if solution.problem.wear is not None:
        fields["worn_depth"] = np.tile(solution.problem.wear, (samples, 1))
    if changes_state(solution):
        fields["contact_state"] = classify_contact(solution, samples).astype(float)
    return fields


def write_pairs(path: Path, interface: Interface, solution: PeriodicSolution) -> None:
    """Writes one row a pair: where it is, and its figures over the period."""
    histories = {name: solution.history(name, SAMPLES) for name in list_histories(solution)}
    state = classify_contact(solution, SAMPLES) if changes_state(solution) else None
    vectors = interface.normal, *interface.tangents.swapaxes(0, 1)
    frame = dict(zip(("normal", "tangent", SECOND + "tangent"), vectors, strict=False))
    columns = {
        "pair": np.arange(len(interface.area)),
        "flank": np.array(interface.flanks)[interface.flank_of_pair],
        **{f"{axis} [m]": place for axis, place in zip("xyz", interface.position.T, strict=False)},
        **{f"{name}_{axis}": part for name, along in frame.items() for axis, part in zip("xyz", along.T, strict=False)},
        "area [m^2]": interface.area,
    }
    units = {"normal_force": "N", "friction_force": "N", "gap": "m", "slip": "m"}
    for name, unit in (units | {SECOND + "friction_force": "N", SECOND + "slip": "m"}).items():
        if name in histories:
            for figure, reduce in (("mean", np.mean), ("min", np.min), ("max", np.max)):
                columns[f"{name}_{figure} [{unit}]"] = reduce(histories[name], axis=0)
    if "slip_velocity" in histories:
        period = 1 / (solution.problem.frequency or 1.0)
        columns["sliding_distance [m/cycle]"] = measure_sliding(solution.sliding_speed(SAMPLES), period)
    if solution.problem.wear is not None:
        columns["worn_depth [m]"] = solution.problem.wear
    for name in histories:
        if name not in HISTORIES + SECOND_HISTORIES:  # a law of the user's own, in its own unit
            columns |= {f"{name}_min": histories[name].min(axis=0), f"{name}_max": histories[name].max(axis=0)}
    for code, name in enumerate(("open", "stick", "slip") if changes_state(solution) else ()):
        columns[f"{name}_share"] = (state == code).mean(axis=0)
    write_table(path, columns)


def summarise(chain: Chain, solution: PeriodicSolution) -> dict:
    """All figures of a run and where they come from, ready for JSON."""
    reduction, model = chain.reduction, chain.reduction.model
    index_map = chain.structure.space.dofmap.index_map
    return {
        "scene": chain.scene.model_dump(mode="json", by_alias=True),
        "solution": {
            "converged": solution.converged,
            "reason": solution.reason,
            "iterations": solution.iterations,
            "fallbacks": list(solution.fallbacks),
            "cautions": list(solution.cautions),
            "residual": solution.residual,
            "unknowns": solution.unknowns,
            "frequency_Hz": solution.problem.frequency,
            "harmonics": list(solution.orders),
            "outputs": {name: _list_amplitudes(solution, name) for name in model.outputs},
            "merit": {name: solution.merit[name] for name in list_figures(solution)},
        },
        "model": {
            "nodes": index_map.size_global,
            "cells": chain.mesh.cells,
            "smallest_scaled_jacobian": chain.mesh.smallest_scaled_jacobian,
            "bodies": dict(chain.mesh.bodies),  # their numbers in mesh_tags.xdmf
            "boundaries": dict(chain.mesh.boundaries),
            "pairs": model.pairs,
            "coordinates": model.size,
            "full_stick_frequencies_Hz": reduction.full_stick.frequency.tolist(),
            **({"full_stick_nodal_diameters": model.cyclic.count_diameters(model.wave_of(1))} if model.cyclic else {}),
            "fixed_interface_frequencies_Hz": reduction.fixed_interface_frequencies.tolist(),
        },
        "ranks": chain.mesh.domain.comm.size,
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
        "system": platform.platform(),
        "git_revision": find_git_revision(),
        "versions": find_versions(),
    }


def find_versions() -> dict[str, str]:
    """Versions of everything that has a say in the numbers."""
    modules = {name: import_module(name) for name in ("ewr_fenicsx", *PACKAGES)}
    return {"python": platform.python_version()} | {
        name: str(getattr(m, "__version__", "?")) for name, m in modules.items()
    }


def find_git_revision() -> str | None:
    """Revision of the checkout that this package runs from; None where it is installed without one."""
    here = Path(__file__)

    def ask(*arguments: str) -> str:
        command = ["git", "-C", str(here.parent), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    try:
        ask("ls-files", "--error-unmatch", here.name)  # no file of ours: a virtual environment in another's checkout
        return ask("describe", "--always", "--dirty", "--abbrev=40")
    except (OSError, subprocess.CalledProcessError):
        return None


def measure_memory() -> float:
    """Largest resident memory of this process so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _check_room(path: Path, domain: dolfinx.mesh.Mesh, fields: int) -> None:
    """Refuses to write a mesh and so many fields where they have no room: on ranks, dolfinx ends the process there.

    Raises:
        OSError: Too little.
    """
    nodes, topology = domain.geometry.index_map().size_global, domain.topology
    corners = dolfinx.cpp.mesh.cell_num_entities(topology.cell_type, 0) * topology.index_map(topology.dim).size_global
    needed = A_FILE + NUMBER * (3 * nodes * (1 + fields) + A_CORNER * corners)
    free = shutil.disk_usage(path.parent).free
    if free < needed:
        why = f"{os.strerror(errno.ENOSPC)}: {free / 1e6:.1f} MB are free there, of up to {needed / 1e6:.1f} needed"
        raise OSError(errno.ENOSPC, why, path)


@contextmanager
def _open_xdmf(path: Path, domain: dolfinx.mesh.Mesh, fields: int = 0) -> Iterator[dolfinx.io.XDMFFile]:
    """An XDMF file that holds the mesh, with room for so many fields; collective.

    Raises:
        OutputError: It has no room.
        OSError: It cannot be written.
    """
    do_with_files(lambda: _check_room(path, domain, fields), domain.comm, path)
    try:
        with dolfinx.io.XDMFFile(domain.comm, str(path), "w") as file:
            file.write_mesh(domain)
            yield file
    except RuntimeError as error:  # all that dolfinx says of files
        free = shutil.disk_usage(path.parent).free / 1e6
        raise OSError(errno.EIO, f"{error} {free:.1f} MB are free there", path) from error
    if domain.comm.rank == 0:
        # dolfinx 0.9 writes https into the name of XInclude; by that name ParaView's Xdmf2 reader crashes
        text = path.read_text(encoding="utf-8")
        path.write_text(text.replace("https://www.w3.org/", "http://www.w3.org/"), encoding="utf-8")


def write_series(
    path: Path, domain: dolfinx.mesh.Mesh, times: RealArray, fields: Iterable[dolfinx.fem.Function]
) -> None:
    """Writes fields of the degree of ``domain``, named like their file; collective."""
    with _open_xdmf(path, domain, len(times)) as file:
        for instant, field in zip(times, fields, strict=True):
            field.name = path.stem
            file.write_function(field, instant)


def _round_series(path: Path) -> None:
    """Makes the values of a series' HDF5 file whole: dolfinx 0.5 adds up shape functions, to 1.99999999999996."""
    with h5py.File(path, "r+") as file:
        for values in file["Function"][path.stem].values():
            values[...] = np.rint(values[...])


def _list_amplitudes(solution: PeriodicSolution, name: str) -> list[dict[str, float]]:
    return [
        {"harmonic": h, "real": float(a.real), "imag": float(a.imag)}
        for h, a in zip(solution.orders, solution.output(name), strict=True)
    ]
