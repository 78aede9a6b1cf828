"""What laws say of themselves, and what they answer: refused, with the remedy, where it makes no sense."""

from __future__ import annotations

from collections.abc import Mapping
from reprlib import repr as shorten
from typing import get_args

import numpy as np

from ewr_fenicsx.errors import ModelError, nearest
from ewr_fenicsx.laws.law_kinds import DIRECTIONS, Law, Motion, Partial, Response, Variable


def check_claims(law: Law) -> None:
    """Refuses a law that cannot be what it says.

    Raises:
        ModelError: Weights of its mean equation that are neither one number nor one a pair; a projection of no such
            motion, without ``admit``, or with an ``impedance`` that is not one a pair; corners that it does not tell.
    """
    name, motions = type(law).__name__, ("displacement", "velocity")
    for weight in ("static_row", "static_force_row", "static_displacement_row", "stick_flexibility"):
        shape = np.shape(getattr(law, weight))
        if shape not in ((), law.pairs.shape):
            raise ModelError(f"{name}.{weight} has shape {shape}; give one number, or one a pair, {law.pairs.shape}")
    if law.opposes:
        if law.opposes not in motions:
            hint = nearest(law.opposes, motions)
            raise ModelError(f'{name}.opposes = {law.opposes!r}; give one of {", ".join(motions)}{hint}, or ""')
        if _lacks(law, "admit"):
            raise ModelError(f'{name}.opposes = "{law.opposes}", but it has no admit; give that, or leave opposes out')
        if law.impedance is not None and np.shape(law.impedance) != law.pairs.shape:
            raise ModelError(
                f"{name}.impedance has shape {np.shape(law.impedance)}; give one a pair, {law.pairs.shape}, or None"
            )
    for method in ("find_corners", "differentiate") if law.has_corners else ():
        if _lacks(law, method):
            raise ModelError(f"{name}.has_corners, but it has no {method}; give that, or leave both out")


def _lacks(law: Law, method: str) -> bool:
    """Whether a law has nothing of its own in place of a method of the protocol."""
    return getattr(getattr(law, method), "__func__", None) is getattr(Law, method)


def read_fields(law: Law, motion: Motion) -> Mapping[str, np.ndarray]:
    """What a law reports besides its force, name -> ``(n_t, K)``.

    Raises:
        ModelError: It reports no dictionary, or values of another shape.
    """
    reported = law.fields(motion)
    if not isinstance(reported, Mapping):
        raise ModelError(
            f"{type(law).__name__}.fields returns {shorten(reported)}; give a dictionary, name -> values of shape "
            "(instants, pairs)"
        )
    shape = motion.force[law.direction].shape
    for name, values in reported.items():
        if np.shape(values) != shape or np.iscomplexobj(values):
            raise ModelError(
                f'{type(law).__name__}.fields returns a "{name}" of shape {np.shape(values)}, '
                f"{np.asarray(values).dtype}; give real numbers of shape {shape}, instants by pairs"
            )
    return reported


def check_response(law: Law, response: object, shape: tuple[int, int]) -> None:
    """Refuses an answer that is none: what the rest would stumble over, or worse, would not notice.

    Raises:
        ModelError: Not a ``Response``, or values, a variable or a direction that it cannot have.
    """
    name = f"{type(law).__name__}.evaluate"
    if not isinstance(response, Response) or not all(isinstance(part, Partial) for part in response.partials):
        raise ModelError(f"{name} returns {shorten(response)}; give a Response(residual, (Partial(...), ...))")
    for part in response.partials:
        for what, given, known in (
            ("variable", part.variable, get_args(Variable)),
            ("direction", part.direction, DIRECTIONS),
        ):
            if given not in known:
                hint = nearest(given, known)
                raise ModelError(
                    f'{name} returns a Partial by the {what} "{given}"; give one of {", ".join(known)}{hint}'
                )
    named = [("residual", response.residual)]
    for part in response.partials:
        told = f"derivative by the {part.direction.replace('_', ' ')} {part.variable.replace('_', ' ')}"
        memory = (("since", part.since), ("kept", part.kept))
        named += [(told, part.values), *((f"{name} of the {told}", at) for name, at in memory if at is not None)]
    for told, values in named:
        if np.shape(values) != shape or np.iscomplexobj(values):
            raise ModelError(
                f"{name} returns a {told} of shape {np.shape(values)}, {np.asarray(values).dtype}; give real numbers "
                f"of shape {shape}, instants by pairs"
            )
