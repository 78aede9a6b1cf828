"""Run by ``test_sweep_parallel.py``: a family of curves on all ranks; each rank writes what it got."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

sys.path.insert(0, str(Path(__file__).parents[1]))

from small_models import dovetail, lift_off_oscillator, stop_oscillator

from ewr_fenicsx import ContactLaws, frequency_response

out = Path(sys.argv[1])
family = {mu: ContactLaws(friction=mu) for mu in (0.1, 0.3)}
curves = frequency_response(dovetail(excitation=200.0), family, np.linspace(500.0, 800.0, 13), folder=out / "family")
laws = ContactLaws(tangential="frictionless", initial_gap=1.0)
folded = frequency_response(stop_oscillator(), laws, np.linspace(0.12, 0.22, 21), harmonics=7, progress=False)
folded.look_at_stability(MPI.COMM_WORLD)
assert folded.unstable.any() and not folded.unstable.all()
friction = ContactLaws(friction=0.3)
accurate = frequency_response(
    lift_off_oscillator(excitation=0.6, damping=0.1), friction, np.linspace(0.08, 0.4, 13), accuracy=0.02
)
np.savez(
    out / f"rank{MPI.COMM_WORLD.rank}.npz",
    low=curves[0.1].output("tip"),
    high=curves[0.3].output("tip"),
    folded=folded.output("tip"),
    frequencies=folded.frequencies,
    unstable=folded.unstable.astype(float),
    accurate=accurate.output("tip"),
    estimate=accurate.table()["estimate"],
    harmonics=accurate.table()["highest_harmonic"],
)
