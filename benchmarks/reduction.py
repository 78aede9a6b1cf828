"""What a large mesh costs before the first contact solve: time by stage, and memory.

    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/reduction.py            some five minutes on one core
    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/reduction.py --quick    the smaller half of the sizes

The gallery's dovetail with ever smaller elements, and with more pairs, each size in a process of its own. The bound of
the reduction is one sparse factorisation of the structure's stiffness, shifted by its mass; the least memory is the
basis, a dense array of all degrees of freedom by all reduced coordinates. Peaks are of the whole process, libraries
included.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
from models import ROOT
from reporting import clock, describe_machine, print_table, write_json

# element size [mm], degree, pairs a flank (of two)
SIZES = ((2.0, 1, 8), (1.0, 2, 8), (0.5, 2, 8), (0.25, 2, 8), (0.5, 1, 40), (0.5, 2, 80), (0.5, 2, 160))


def measure(element: float, degree: int, pairs: int) -> dict:
    """One size in this process: the chain, then one factorisation of what it assembled."""
    from mpi4py import MPI

    from ewr_fenicsx import load_scene
    from ewr_fenicsx.structure.chain import build_chain
    from ewr_fenicsx.structure.columns import factorise

    scene = load_scene(ROOT / "demos" / "dovetail.toml")
    parameters = {**scene.geometry.parameters, "mesh_size": 1e-3 * element, "pairs": pairs}
    scene = scene.model_copy(
        update={
            "geometry": scene.geometry.model_copy(update={"parameters": parameters}),
            "elasticity": scene.elasticity.model_copy(update={"degree": degree}),
        }
    )
    chain = build_chain(scene, MPI.COMM_SELF)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    matrix = chain.structure.stiffness.copy()
    matrix.axpy((2 * np.pi * 100) ** 2, chain.structure.mass)
    _, factorisation = clock(lambda: factorise(matrix), 3)
    return {
        "element_mm": element,
        "degree": degree,
        "pairs": chain.reduction.model.pairs,
        "dofs": chain.reduction.basis.shape[0],
        "coordinates": chain.reduction.model.size,
        "seconds": dict(chain.seconds),
        "factorisation_seconds": factorisation,
        "basis_megabytes": chain.reduction.basis.nbytes / 1e6,
        "peak_megabytes": peak,
    }


def measure_apart(size: tuple[float, int, int]) -> dict:
    """The same in a process of its own, whose peak is that of this size."""
    command = [sys.executable, __file__, "--one", *map(str, size)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="only the smaller sizes")
    parser.add_argument("--one", nargs=3, type=float, metavar=("MM", "DEGREE", "PAIRS"), help="print one size as JSON")
    parser.add_argument("--output", type=Path, help="JSON file [benchmarks/results/reduction.json]")
    arguments = parser.parse_args()
    if arguments.one:
        element, degree, pairs = arguments.one
        print(json.dumps(measure(element, int(degree), int(pairs))))
        return
    content: dict[str, object] = {"machine": describe_machine()}
    sizes = [size for size in SIZES if not arguments.quick or (size[0] >= 0.5 and size[2] <= 40)]
    measured = []
    for size in sizes:
        measured.append(measure_apart(size))
        print(f"{size[0]:g} mm, degree {size[1]}, {size[2]} pairs a flank: done", flush=True)
    header = ["dofs", "degree", "pairs", "n", "mesh s", "matrices s", "interface s", "reduction s"]
    header += ["one factorisation s", "reduction over it", "basis MB", "peak MB"]
    rows = []
    for m in measured:
        factor, stages = m["factorisation_seconds"], m["seconds"]
        stages = [stages[name] for name in ("mesh", "matrices", "interface", "reduction")]
        sizes = [m[key] for key in ("dofs", "degree", "pairs", "coordinates")]
        rows.append([*sizes, *stages, factor, stages[-1] / factor, m["basis_megabytes"], m["peak_megabytes"]])
    print_table("From a geometry to the reduced model", header, rows)
    write_json("reduction", content | {"sizes": measured, "header": header, "table": rows}, arguments.output)


if __name__ == "__main__":
    main()
