"""``frequency_response`` under ``mpirun``: blocks of frequencies and parameters spread over ranks, the same curves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

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


def test_curves_do_not_depend_on_the_number_of_ranks(mpirun, tmp_path):
    found = {}
    for ranks in (1, 2, 3):
        folder = tmp_path / str(ranks)
        folder.mkdir()
        done = mpirun(ranks, "python", "-m", "mpi4py", SCRIPT, folder)
        assert done.returncode == 0, done.stderr
        assert (folder / "family" / "frequency_response.h5").exists()
        assert len(list((folder / "family" / "blocks").iterdir())) == 4
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
