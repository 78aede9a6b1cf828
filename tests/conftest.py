"""What every test needs: thread counts, quiet loggers, reproducible hypothesis runs, `mpirun`; and `benchmarks/`."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

# BLAS reads these once, when numpy loads it: before any other import. `make test` has set them already. One thread:
# sums are then rounded alike on machines with other numbers of cores.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
os.environ.setdefault("MPLBACKEND", "Agg")

import logging  # noqa: E402

import hypothesis  # noqa: E402
import pytest  # noqa: E402

# The same examples every time: a red run can be repeated. The time of one example depends on the machine: no deadline.
hypothesis.settings.register_profile("ewr", derandomize=True, deadline=None, print_blob=True)
hypothesis.settings.load_profile("ewr")

for _name in ("FFCx", "ffcx", "UFL", "matplotlib", "numba"):
    logging.getLogger(_name).setLevel(logging.WARNING)
# setuptools raises the root logger to INFO and reports the compiler's command lines on it: a level would not hold.
logging.getLogger().addFilter(lambda record: record.levelno > logging.INFO)

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

# Taken before any MPI_Init in this process, which leaves variables in the C environment that break a nested mpirun.
_ENVIRONMENT = dict(os.environ)


@pytest.fixture
def mpirun(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Start a command on several MPI ranks and wait for it.

    Returns:
        ``mpirun(ranks, *argv, timeout=300.0, cwd=tmp_path) -> CompletedProcess`` with text output; the exit code is for
        the test to check. ``stderr`` has mpirun's own and then each rank's in turn, which went to files: of a rank that
        aborts, mpirun may lose the last words. ``python`` and ``ewr`` in ``argv`` are those of this environment. The
        cores are divided among the ranks. Start bare scripts as ``"python", "-m", "mpi4py", script``: an exception on
        one rank then stops all.
    """

    def run(
        ranks: int, *argv: str | os.PathLike[str], timeout: float = 300.0, cwd: Path = tmp_path
    ) -> subprocess.CompletedProcess[str]:
        threads = str(max(1, len(os.sched_getaffinity(0)) // ranks))
        environment = _ENVIRONMENT | {
            "PATH": f"{Path(sys.executable).parent}:{_ENVIRONMENT['PATH']}",
            "OPENBLAS_NUM_THREADS": threads,
            "OMP_NUM_THREADS": threads,
            "OMPI_ALLOW_RUN_AS_ROOT": "1",
            "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
            # Ranks that share a core must not spin while they wait: ten times slower otherwise.
            "OMPI_MCA_mpi_yield_when_idle": "1",
            # One machine: shared memory alone. TCP and kernel-assisted copies only complain in a bare container.
            "OMPI_MCA_btl": "^tcp",
            "OMPI_MCA_btl_vader_single_copy_mechanism": "none",
            "PYTHONFAULTHANDLER": "1",
        }
        # mpirun's own timeout ends the ranks too; ours is for an mpirun that hangs itself.
        launch = ["mpirun", "-n", str(ranks), "--bind-to", "none", "--map-by", ":OVERSUBSCRIBE"]
        launch += ["--timeout", str(int(timeout))]
        said = tmp_path_factory.mktemp("stderr_of_ranks")  # tests look at what a run leaves in its own folder
        launch += ["sh", "-c", f'exec "$@" 2> {shlex.quote(str(said))}/$OMPI_COMM_WORLD_RANK', "rank"]
        finished = subprocess.run(
            [*launch, *map(os.fspath, argv)],
            cwd=cwd,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=timeout + 30,
            check=False,
        )
        finished.stderr += "".join(
            (said / str(rank)).read_text() for rank in range(ranks) if (said / str(rank)).exists()
        )
        return finished

    return run


@pytest.fixture
def headless() -> tuple[str, ...]:
    """Runs a command on a display that nobody sees, of a number of its own: two that start at once took the same."""
    return ("xvfb-run", "-a", "-n", str(100 + os.getpid() % 10_000))
