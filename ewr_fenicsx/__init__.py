"""Periodic vibration, friction, separation and fretting wear of jointed structures, in the frequency domain."""

from __future__ import annotations

from importlib import import_module

__version__ = "0.1.0"

# Names are imported when first used: a script with matrices of its own never loads dolfinx.
_HOME = {
    "ReducedModel": "reduced_model",
    "ContactLaws": "contact_laws",
    "ContactProblem": "contact_problem",
    "PeriodicSolution": "solution",
    "solve": "solving",
    "solve_to_accuracy": "accuracy",
    "integrate": "time_integration",
    "frequency_response": "frequency_sweep",
    "evolve_wear": "wear",
    "Tolerance": "cycle_jumps",
    "load_scene": "scene",
    "build_reduced_model": "chain",
}
__all__ = sorted(_HOME)


def __getattr__(name: str):
    if name in _HOME:
        return getattr(import_module(f"ewr_fenicsx.{_HOME[name]}"), name)
    raise AttributeError(f"module 'ewr_fenicsx' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
