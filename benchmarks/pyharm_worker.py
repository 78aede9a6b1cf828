"""Runs in pyHarm's own environment: sweeps one exported model and writes answers and times. ``peers.py`` starts it.

    python pyharm_worker.py CASE.npz RESULT.json

pyHarm's own three-directional contact element has two tangents; this model has one. So the element below puts its two
laws, dynamic-Lagrangian unilateral contact and friction, together with one tangent, through its plugin interface: no
unknown more than the model has.
"""

from __future__ import annotations

import json
import logging
import sys
import time
from importlib import metadata

import jax
import numpy as np
from pyHarm.BaseUtilFuncs import pyHarm_plugin
from pyHarm.Elements.NodeToNodeElements.DLFTElements.DLFT3D import DLFT3D
from pyHarm.Elements.NodeToNodeElements.DLFTElements.DLFTFriction import DLFTFrictionResidual_jax
from pyHarm.Elements.NodeToNodeElements.DLFTElements.DLFTUniGap import DLFTUniGapResidual_jax
from pyHarm.Maestro import Maestro
from pyHarm.Systems.System import System

MOST_FAILURES = 4  # in a row, after which a sweep is given up


@jax.jit
def balance_pair(x, om, linear, bodies, directions, slave, master, mu, gap, eps, to_time, to_harmonics):
    """pyHarm's contact and friction in the plane: direction 0 is normal, 1 tangential; preload comes from the load."""
    contact, force = DLFTUniGapResidual_jax(
        x, om, linear, bodies, directions[:1], slave, master, gap, eps, to_time, to_harmonics, 0.0
    )
    friction, _ = DLFTFrictionResidual_jax(
        x, om, linear, bodies, directions[1:2], slave, master, mu, 0.0, eps, to_time, to_harmonics, force
    )
    return contact + friction


differentiate = jax.jit(jax.jacfwd(balance_pair))
differentiate_whole = jax.jit(jax.jacfwd(balance_pair, argnums=(0, 2)))


class PlaneContact(DLFT3D):
    """Unilateral contact with Coulomb friction along one tangent, dynamic-Lagrangian."""

    factory_keyword = "PlaneContact"
    mended = False

    def _arguments(self, xg, om, linear):
        return (
            xg[self.indices], om, linear[self.indices], float(self.nbSub), self.Pdir, self.Pslave, self.Pmaster,
            self.mu, self.g, self.eps, self.D["ft"], self.D["tf"],
        )  # fmt: skip

    def evalResidual(self, xg, om, Rglin=None):  # noqa: N802
        self.R = np.asarray(balance_pair(*self._arguments(xg, om, Rglin)))
        return self.R

    def evalJacobian(self, xg, om, Rglin=None, dJgdxlin=None, dJgdomlin=None):  # noqa: N802
        arguments = self._arguments(xg, om, Rglin)
        if self.mended:
            self.J, self.through = (np.asarray(part) for part in differentiate_whole(*arguments))
        else:
            self.J = np.asarray(differentiate(*arguments))
        self.dJdom = np.zeros(self.indices.size)
        return self.J, self.dJdom


class MendedSystem(System):
    """pyHarm's system with the derivative of the contact forces through the linear part of the residual.

    pyHarm leaves it out (``DLFT3D``) or keeps it within the pair's own coordinates (``DLFTFriction``): the Jacobian is
    then wrong wherever a pair is next to another one or to an inner coordinate. ``PlaneContact.mended`` switches.
    """

    factory_keyword = "Mended"

    def _jacobian(self, list_of_elems, x, **kwargs):
        whole, by_frequency = super()._jacobian(list_of_elems, x, **kwargs)
        if PlaneContact.mended:
            for element in list_of_elems:
                if isinstance(element, PlaneContact):
                    whole[element.indices] += element.through @ kwargs["dJgdxlin"][element.indices]
        return whole, by_frequency


def describe_system(case: dict[str, np.ndarray], eps: float) -> dict:
    """pyHarm's input: two substructures of plane nodes, one contact element a pair, one forcing a loaded coordinate."""
    bodies = ("blade", "disk")
    half = case["mass"].shape[0] // 2
    part = {body: slice(i * half, (i + 1) * half) for i, body in enumerate(bodies)}
    substructures = {
        body: {
            "matrix": {"M": case["mass"][at, at], "C": case["damping"][at, at], "K": case["stiffness"][at, at]},
            "ndofs": 2,
        }
        for body, at in part.items()
    }
    connectors = {
        f"pair{k}": {
            "type": "PlaneContact",
            "connect": {"blade": [k], "disk": [k]},
            "dirs": [1, 0],  # y is the normal, x the tangent
            "mu": float(case["friction"]), "N0": 0.0, "g": 0.0, "eps": eps,
        }
        for k in range(int(case["pairs"]))
    }  # fmt: skip
    for h, load in enumerate((case["load0"], case["load1"])):
        for i in np.flatnonzero(load):
            body, local = bodies[i // half], int(i % half)
            amplitude, phase = (abs(load[i]), -np.angle(load[i])) if h else (load[i].real, 0.0)
            connectors[f"load{h}_{i}"] = {
                "type": "GOForcing", "connect": {body: [local // 2]}, "dirs": [local % 2],
                "dto": 0, "ho": h, "amp": float(amplitude), "phi": float(phase),
            }  # fmt: skip
    return {
        "substructures": substructures,
        "connectors": connectors,
        "system": {
            "type": "Mended",
            "nh": int(case["harmonics"]),
            "nti": int(case["samples"]),
            "adim": {"status": False},
        },
    }


def sweep(case: dict[str, np.ndarray], eps: float, solver: str, most_seconds: float) -> dict[str, object]:
    """All frequencies once, each from the last one that was solved.

    Returns:
        By point: times [s], residual norms, whether it was solved, and the coordinates' complex amplitudes
        ``(points, n_h, n)`` as real and imaginary part.
    """
    omegas, tolerance = case["omegas"], float(case["tolerance"])
    options = {
        "NewtonRaphson": {"tol_residual": tolerance, "tol_delta_x": 1e6, "max_iter": 40},
        "scipyroot": {"root": {"method": "hybr", "options": {"xtol": 1e-10}}, "residual_tolerance": tolerance},
    }[solver]
    maestro = Maestro(
        describe_system(case, eps)
        | {
            "plugin": [],
            "analysis": {
                "sweep": {
                    "study": "frf", "solver": solver, "solver_options": options, "predictor": "previous",
                    "corrector": "nocontinuation", "stepsizer": "constant", "ds0": float(omegas[1] - omegas[0]),
                    "ds_max": 1e9, "ds_min": 0.0, "puls_start": float(omegas[0]), "puls_inf": 0.0,
                    "puls_sup": float(omegas[-1]), "verbose": False, "purge_jacobians": True,
                }
            },
        }
    )  # fmt: skip
    analysis, system = maestro.nls["sweep"], maestro.system
    seconds, residuals, answers, last, failures = [], [], [], omegas[0], 0
    for k, omega in enumerate(omegas):
        begin = time.process_time()
        if k == 0:
            analysis.initialise(stick_everywhere(system, case))
        else:
            analysis.ds = float(omega - last)
            analysis.makeStep(index_insolve=k)
        seconds.append(time.process_time() - begin)
        found = analysis.SolList[-1]
        residuals.append(float(np.linalg.norm(found.R_solver)))
        answers.append(read_coordinates(system, case, found.x[:-1]))
        found.flag_accepted = residuals[-1] <= 10 * tolerance
        analysis.purge_jacobians()
        if found.flag_accepted:
            last = omega
        failures = 0 if found.flag_accepted else failures + 1
        if (k == 0 and failures) or failures == MOST_FAILURES or sum(seconds) > most_seconds:
            break
    answers = np.array(answers)
    return {
        "seconds": seconds, "residuals": residuals,
        "solved": [bool(residual <= 10 * tolerance) for residual in residuals],
        "real": answers.real.tolist(), "imaginary": answers.imag.tolist(),
    }  # fmt: skip


def measure_jacobian_error(case: dict[str, np.ndarray], eps: float) -> float:
    """Relative error of the system's Jacobian along a random direction, against a central difference.

    At a random point near full stick, where some pairs slip or open.
    """
    system = Maestro(describe_system(case, eps) | {"plugin": [], "analysis": {}}).system
    rng = np.random.default_rng(0)
    x = stick_everywhere(system, case)
    x = np.append(x + 0.05 * rng.normal(size=x.size), case["omegas"][0])
    step = np.append(1e-6 * rng.normal(size=x.size - 1), 0.0)
    difference = 0.5 * (system.Residual(x + step) - system.Residual(x - step))
    error = system.Jacobian(x)[0] @ step[:-1] - difference
    return float(np.linalg.norm(error) / np.linalg.norm(difference))


def stick_everywhere(system, case: dict[str, np.ndarray]) -> np.ndarray:
    """Linear solution at the first frequency with every pair bonded, pyHarm's unknowns.

    Its own start, the linear solution without contact, has no contact force: its friction law divides by zero there.
    """
    bonds, omega = np.vstack([case["normal"], case["tangential"]]), case["omegas"][0]
    basis = np.linalg.svd(bonds)[2][len(bonds) :].T
    amplitudes = []
    for h, load in enumerate((case["load0"], case["load1"])):
        dynamic = case["stiffness"] + 1j * h * omega * case["damping"] - (h * omega) ** 2 * case["mass"]
        amplitudes.append(basis @ np.linalg.solve(basis.T @ dynamic @ basis, basis.T @ load))
    start = np.zeros(len(system.expl_dofs))
    for row, dof in enumerate(system.expl_dofs.itertuples()):
        if dof.harm < 2:
            value = amplitudes[dof.harm][find_coordinate(dof, case)]
            start[row] = value.real if dof.cs == "c" else -value.imag
    return start


def find_coordinate(dof, case: dict[str, np.ndarray]) -> int:
    """The model's coordinate that a row of pyHarm's table of unknowns belongs to."""
    return (0 if dof.sub == "blade" else case["mass"].shape[0] // 2) + 2 * dof.node_num + dof.dof_num


def read_coordinates(system, case: dict[str, np.ndarray], unknowns: np.ndarray) -> np.ndarray:
    """``(n_h, n)`` complex amplitudes of the model's coordinates from pyHarm's cosine and sine coefficients."""
    amplitudes = np.zeros((int(case["harmonics"]) + 1, case["mass"].shape[0]), dtype=complex)
    for value, dof in zip(unknowns, system.expl_dofs.itertuples(), strict=True):
        amplitudes[dof.harm, find_coordinate(dof, case)] += value * (1.0 if dof.cs == "c" else -1j)
    return amplitudes


def main() -> None:
    case = dict(np.load(sys.argv[1]))
    logging.disable(logging.CRITICAL)
    if jax.numpy.zeros(1).dtype != np.float64:
        raise SystemExit("JAX runs in single precision; set JAX_ENABLE_X64=1")
    pyHarm_plugin(PlaneContact)
    pyHarm_plugin(MendedSystem)
    runs = []
    for mended in case["mended"]:
        PlaneContact.mended = bool(mended)
        for eps in case["eps"]:
            error = measure_jacobian_error(case, float(eps))
            for solver in case["solvers"]:
                settings = {"mended": bool(mended), "eps": float(eps), "solver": str(solver), "jacobian_error": error}
                try:
                    sweep(dict(case, omegas=case["omegas"][:2]), float(eps), solver, 60.0)  # compilation is not timed
                    result = sweep(case, float(eps), solver, float(case["most_seconds"]))
                except np.linalg.LinAlgError as error:
                    result = {"solved": [], "seconds": [], "real": [], "imaginary": [], "failure": str(error)}
                runs.append(settings | result)
    versions = {name: metadata.version(name) for name in ("pyHarm-os", "jax", "numpy", "scipy")}
    with open(sys.argv[2], "w", encoding="utf-8") as file:
        json.dump({"versions": versions, "runs": runs}, file)


if __name__ == "__main__":
    main()
