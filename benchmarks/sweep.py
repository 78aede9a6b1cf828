"""How long a frequency response takes, and how much faster two ranks are than one.

    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/sweep.py [--output FILE]

Runs itself under ``mpirun`` with one and with two ranks, in turn and several times, and takes medians. One BLAS thread
a rank. The speed-up means something only while both cores are free: see the load average printed first.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

REPEATS = 3
FRICTION = (0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
FREQUENCIES = np.concatenate([np.arange(500, 850, 50), np.arange(850, 1151, 12.5), np.arange(1200, 1501, 50)])


def measure(out: Path, model_file: Path) -> None:
    """On each rank: one family of curves; rank 0 writes time and result."""
    from mpi4py import MPI

    from ewr_fenicsx import ContactLaws, ReducedModel, frequency_response

    model, comm = ReducedModel.load(model_file), MPI.COMM_WORLD
    family = {mu: ContactLaws(friction=mu) for mu in FRICTION}
    comm.Barrier()
    begin = time.perf_counter()
    curves = frequency_response(model, family, FREQUENCIES, harmonics=5, progress=False)
    seconds = time.perf_counter() - begin
    if comm.rank == 0:
        tips = np.concatenate([curve.output("tip") for curve in curves.values()])
        np.savez(out, seconds=seconds, tips=tips)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, help="JSON file [benchmarks/results/sweep.json]")
    parser.add_argument("--measure", nargs=2, type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        measure(*arguments.measure)
        return
    from models import blade_root
    from reporting import describe_machine, print_table, write_json

    machine = describe_machine()
    environment = os.environ | {
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMPI_MCA_mpi_yield_when_idle": "1",
    }
    seconds: dict[int, list[float]] = {1: [], 2: []}
    tips = {}
    with tempfile.TemporaryDirectory() as folder:
        model_file = Path(folder) / "blade.h5"
        blade_root().save(model_file)
        # a subprocess that starts MPI must not inherit the address of this process's own
        environment = {k: v for k, v in environment.items() if not k.startswith(("PMIX_", "OMPI_COMM_", "ORTE_"))}
        for _ in range(REPEATS):
            for ranks in seconds:
                out = Path(folder) / f"{ranks}.npz"
                command = ["mpirun", "-n", str(ranks), "--bind-to", "none", sys.executable, "-m", "mpi4py", __file__]
                subprocess.run([*command, "--measure", out, model_file], env=environment, check=True)
                found = np.load(out)
                seconds[ranks].append(float(found["seconds"]))
                tips[ranks] = found["tips"]
    difference = float(np.abs(tips[2] - tips[1]).max() / np.abs(tips[1]).max())
    median = {ranks: float(np.median(values)) for ranks, values in seconds.items()}
    rows = [[ranks, median[ranks], median[1] / median[ranks]] for ranks in seconds]
    points = len(FRICTION) * len(FREQUENCIES)
    print_table(f"{len(FRICTION)} curves, {points} points, N = 5, 40 pairs", ["ranks", "seconds", "speed-up"], rows)
    print(f"largest difference of the tip between one rank and two: {difference:.1e} of the largest amplitude")
    content = {"machine": machine, "points": points, "seconds": seconds, "speed_up": median[1] / median[2]}
    write_json("sweep", content | {"difference": difference}, arguments.output)


if __name__ == "__main__":
    main()
