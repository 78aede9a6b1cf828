"""Periodic vibration, friction, separation and fretting wear of jointed structures, in the frequency domain."""

from __future__ import annotations

from importlib import import_module

__version__ = "0.1.0"

# Names are imported when first used: a script with matrices of its own never loads dolfinx.
_HOME = {
    "ReducedModel": "model.reduced_model",
    "close_ring": "model.ring",
    "unroll_ring": "model.ring",
    "ContactLaws": "laws.contact_laws",
    "ContactProblem": "problem.contact_problem",
    "PeriodicSolution": "solution.solution",
    "solve": "accuracy.solving",
    "solve_to_accuracy": "accuracy.accuracy",
    "integrate": "solver.time_integration",
    "State": "in_time.time_stepping",
    "frequency_response": "response.frequency_sweep",
    "evolve_wear": "wear.wear",
    "Tolerance": "wear.cycle_jumps",
    "Scene": "scene.scene",
    "load_scene": "scene.scene",
    "build_reduced_model": "structure.chain",
}
__all__ = sorted(_HOME)


def __getattr__(name: str):
    if name in _HOME:
        return getattr(import_module(f"ewr_fenicsx.{_HOME[name]}"), name)
    raise AttributeError(f"module 'ewr_fenicsx' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
