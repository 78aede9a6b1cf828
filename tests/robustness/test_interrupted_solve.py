"""What ends a script within a Newton step leaves its own traceback, and no crash of PETSc."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1]
SCRIPT = """
from small_models import PROBLEMS
from ewr_fenicsx import solve
from ewr_fenicsx.solver import snes
calls = []
def stop(self, *_):
    calls.append(1)
    if len(calls) == 3:
        raise {error}
    return evaluate(self, *_)
evaluate, snes._Equations.evaluate = snes._Equations.evaluate, stop
solve(PROBLEMS["floating, slip"])
"""


@pytest.mark.parametrize("error, codes", [("KeyboardInterrupt", (130, -2)), ("ValueError", (1,))])
def test_what_ends_a_script_within_a_newton_step_does_not_crash_petsc(error, codes):
    """As Ctrl-C, or a mistake in a law of one's own: its traceback held what PETSc found alive when it had ended."""
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT.replace("{error}", error)],
        env=os.environ | {"PYTHONPATH": f"{FOLDER.parent}:{FOLDER}"},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert run.stderr.splitlines()[-1] == error and "in stop" in run.stderr
    assert run.returncode in codes
