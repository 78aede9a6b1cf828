"""``frequency_response`` under ``mpirun``: blocks of frequencies and parameters spread over ranks, the same curves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ewr_fenicsx.task_sharing import share_tasks

pytestmark = pytest.mark.parallel
SCRIPT = Path(__file__).with_name("sweep_on_ranks.py")
FAILING = """
from mpi4py import MPI
from ewr_fenicsx.task_sharing import share_tasks

def work(task):
    if task == 3:
        raise ValueError("task 3")
    return task

try:
    share_tasks(range(8), work, MPI.COMM_WORLD)
except ValueError as error:
    print(f"caught {error}\\n", end="", flush=True)
"""
ONE_FAILS = """
from mpi4py import MPI
from ewr_fenicsx.task_sharing import do_on_rank_zero, do_together

comm = MPI.COMM_WORLD
assert do_together(lambda: 10 * comm.rank, comm) == 10 * comm.rank
assert do_on_rank_zero(lambda: 10 + comm.rank, comm) == 10
for fails in (
    lambda: do_together(lambda: 1 / (1 - comm.rank), comm),
    lambda: do_on_rank_zero(lambda: 1 / comm.rank, comm),
):
    try:
        fails()
    except ZeroDivisionError as error:
        print(f"caught {error}\\n", end="", flush=True)
"""

INTERRUPTED = """
import time
from mpi4py import MPI
from ewr_fenicsx.task_sharing import share_tasks

comm = MPI.COMM_WORLD

def work(task):
    if comm.rank == 1:
        raise KeyboardInterrupt
    time.sleep(0.05)

since = time.monotonic()
try:
    share_tasks(range(200), work, comm)
except KeyboardInterrupt:
    print("left before the others were done" if time.monotonic() - since < 5 else "left late", flush=True)
    comm.Abort(130)
"""

STRANGE = """
from mpi4py import MPI
from ewr_fenicsx.task_sharing import do_together, share_tasks

comm = MPI.COMM_WORLD

def lose(task):
    class Local(Exception):
        pass
    raise Local(f"task {task}")

def hold(task):
    error = ValueError("held")
    error.best = lambda: task
    raise error

class TwoWords(Exception):
    def __init__(self, first, second):
        super().__init__(f"{first} {second}")

def ask_for_two(task):
    raise TwoWords("two", "words")

def report(begun):
    if begun == 0:
        raise BrokenPipeError("gone")

for fails in (
    lambda: share_tasks(range(1), lose, comm),
    lambda: share_tasks(range(1), hold, comm),
    lambda: share_tasks(range(1), ask_for_two, comm),
    lambda: share_tasks(range(8), abs, comm, report),
    lambda: do_together(lambda: lose(7) if comm.rank else None, comm),
):
    try:
        fails()
    except (RuntimeError, BrokenPipeError) as error:
        print(f"caught {error}\\n", end="", flush=True)
"""


def test_curves_do_not_depend_on_the_number_of_ranks(mpirun, tmp_path):
    found = {}
    for ranks in (1, 2, 3):
        folder = tmp_path / str(ranks)
        folder.mkdir()
        done = mpirun(ranks, "python", "-m", "mpi4py", SCRIPT, folder)
        assert done.returncode == 0, done.stderr
        assert (folder / "family" / "frequency_response.h5").exists()
        assert len(list((folder / "family" / "blocks").glob("00*.h5"))) == 4
        found[ranks] = [dict(np.load(folder / f"rank{rank}.npz")) for rank in range(ranks)]
    for ranks, results in found.items():
        for result in results:
            for name, values in found[1][0].items():
                assert result[name].shape == values.shape, f"{name} on {ranks} ranks"
                np.testing.assert_allclose(result[name], values, atol=1e-8 * np.abs(values).max(), err_msg=name)


def test_a_failed_task_is_an_error_on_every_rank(mpirun):
    done = mpirun(2, "python", "-m", "mpi4py", "-c", FAILING, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("caught task 3") == 2


def test_what_fails_on_one_rank_is_an_error_on_every_one(mpirun):
    done = mpirun(2, "python", "-m", "mpi4py", "-c", ONE_FAILS, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("caught division by zero") == 4


def test_what_no_rank_can_be_sent_is_an_error_on_every_one_as_well(mpirun):
    """Errors that cannot be pickled or not be put together again, and those of who reports."""
    done = mpirun(2, "python", "-m", "mpi4py", "-c", STRANGE, timeout=60)
    assert done.returncode == 0, done.stderr
    for told in ("Local: task 0", "ValueError: held", "TwoWords: two words", "gone", "Local: task 7"):
        assert done.stdout.count(f"caught {told}") == 2, done.stdout


def test_an_interrupted_rank_does_not_wait_for_the_work_of_others(mpirun):
    """Which would do all that is left of a sweep first, as long as that takes."""
    done = mpirun(2, "python", "-m", "mpi4py", "-c", INTERRUPTED, timeout=60)
    assert done.returncode == 130, done.stderr
    assert done.stdout == "left before the others were done\n"


def test_a_rank_by_itself_raises_what_it_caught():
    error = ValueError("held")
    error.best = lambda: None  # which cannot be pickled

    def fail(task: int) -> None:
        raise error

    with pytest.raises(ValueError) as caught:
        share_tasks(range(3), fail)
    assert caught.value is error
