"""How the benchmarks report: what the machine was like, a table on the screen, the same numbers as JSON."""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
import scipy

Result = TypeVar("Result")
RESULTS = Path(__file__).resolve().parent / "results"
THREAD_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def describe_machine() -> dict[str, object]:
    """Cores, BLAS threads, load average and versions: printed first, so that a disturbed run shows.

    Raises:
        SystemExit: The number of BLAS threads is left to the machine, and would be part of every figure.
    """
    cores = len(os.sched_getaffinity(0))
    threads = next((int(os.environ[name]) for name in THREAD_VARIABLES if os.environ.get(name, "").isdigit()), None)
    if threads is None:
        raise SystemExit("set the number of threads: OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/...")
    machine = {
        "cores": cores,
        "blas_threads": threads,
        "load_average": [round(load, 2) for load in os.getloadavg()],
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }
    print(
        f"{cores} cores, {threads} BLAS threads, load average {' '.join(map(str, machine['load_average']))}"
        f" (1, 5, 15 min), numpy {np.__version__}, scipy {scipy.__version__}"
    )
    return machine


def clock(run: Callable[[], Result], repeats: int = 1) -> tuple[Result, float]:
    """A call's last result, and the processor time that it took [s]: of so many, the shortest."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        result = run()
        times.append(time.process_time() - begin)
    return result, min(times)


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """A table with its columns aligned: words to the left, numbers to the right."""
    text = [[_show(cell) for cell in row] for row in rows]
    widths = [max(len(line[i]) for line in [list(header), *text]) for i in range(len(header))]
    numeric = [bool(rows) and all(not isinstance(row[i], str) for row in rows) for i in range(len(header))]
    print(f"\n{title}")
    for line in [list(header), ["-" * width for width in widths], *text]:
        print(
            "  ".join(
                c.rjust(w) if right else c.ljust(w) for c, w, right in zip(line, widths, numeric, strict=True)
            ).rstrip()
        )


def _show(cell: object) -> str:
    if isinstance(cell, float):
        return f"{cell:.3g}"
    return "" if cell is None else str(cell)


def write_json(name: str, content: dict[str, object], path: Path | None = None) -> Path:
    """Write results to ``benchmarks/results/<name>.json`` or to a path of the user's choice."""
    path = path or RESULTS / f"{name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1, default=_plain, allow_nan=False) + "\n", encoding="utf-8")
    print(f"\nwrote {path}")
    return path


def _plain(value: object) -> object:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")
