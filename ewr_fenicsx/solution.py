"""A periodic solution: force amplitudes, and everything that follows from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ewr_fenicsx import indicators
from ewr_fenicsx.balance import HarmonicBalance
from ewr_fenicsx.compliance import receptance
from ewr_fenicsx.contact_problem import ContactProblem
from ewr_fenicsx.errors import ModelError, nearest
from ewr_fenicsx.floquet import find_growth, tell_where_to
from ewr_fenicsx.given import ComplexArray, RealArray, read_samples
from ewr_fenicsx.harmonics import FourierBasis, sample_amplitudes
from ewr_fenicsx.ignored import list_ignored
from ewr_fenicsx.stability import alternates, find_side
from ewr_fenicsx.walking import DOUBTFUL, MAY_WALK, walks

FINE = 1024  # samples a period, at least, on which violations of the laws are looked for
COARSE_ENERGY, COARSE_TENSION = 0.01, 0.1  # imbalance, and tension over the largest force, that are worth a word
LITTLE_EXCHANGE = 1e-6  # energy gained and lost over that swinging to and fro, below which their balance is rounding
HISTORIES = ("normal_force", "friction_force", "admissible_friction_force", "gap", "slip", "slip_velocity")
SECOND = "second_"  # before the name of a history: along the second tangent of pairs in 3-D
SECOND_HISTORIES = tuple(SECOND + name for name in HISTORIES if name not in ("normal_force", "gap"))


@dataclass(frozen=True, eq=False, repr=False)
class PeriodicSolution:
    """Result of ``solve``; the histories and figures of merit are computed when asked for.

    Attributes:
        problem: What was solved.
        forces: ``(n_h, m)`` complex amplitudes of the unknown contact forces, rows as in ``problem.system`` [N].
        rigid: ``(r,)`` mean rigid coordinates of floating bodies [m].
        converged: Whether the residual met the tolerance.
        reason: Why the solve stopped.
        iterations: Newton steps, fallbacks included.
        fallbacks: Every rung of the ladder that was taken, in order; empty where the first attempt converged.
        residual: Norm of the weighted residual over the natural force.
        seconds: Wall time of the solve.
        unknowns: Number of unknowns given to Newton, 0 for a linear problem.
        stages: Wall time of the solve by stage [s].
        left_out: Harmonics at which the contact forces are zero by symmetry, so that the solve did without.
        why_left_out: By which symmetry.
    """

    problem: ContactProblem
    forces: ComplexArray
    rigid: RealArray
    converged: bool
    reason: str
    iterations: int
    fallbacks: tuple[str, ...]
    residual: float
    seconds: float
    unknowns: int
    stages: Mapping[str, float] = field(default_factory=dict)
    left_out: tuple[int, ...] = ()
    why_left_out: str = ""

    def __repr__(self) -> str:
        where = f"{self.problem.frequency:g} Hz, {self.problem.model.pairs} pairs, harmonics up to {self.orders[-1]}"
        return f"PeriodicSolution({where}, {self.iterations} Newton steps: {self.reason})"

    @property
    def orders(self) -> tuple[int, ...]:
        """Harmonics of every amplitude array."""
        return self.problem.basis.orders

    def output(self, name: str) -> ComplexArray:
        """One-sided complex amplitudes ``(n_h,)`` of a named output of the model.

        Raises:
            ModelError: The model has no such output.
        """
        known = self.problem.model.outputs
        if name not in known:
            raise ModelError(f'no output "{name}"; the model has {sorted(known)}{nearest(name, known)}')
        return self.problem.system.compliance.output(name, self.forces, self.rigid)

    @cached_property
    def coordinates(self) -> ComplexArray:
        """Amplitudes of the reduced coordinates, ``(n_h, n)``."""
        system = self.problem.system
        amplitudes = np.zeros((len(self.orders), system.model.size), dtype=complex)
        for j, h in enumerate(self.orders):
            force = system.rows.T @ self.forces[j] + system.load.get(h, 0)
            amplitudes[j] = receptance(system.model, h * self.problem.omega, None, force[:, None])[:, 0]
        if self.rigid.size:
            # the generalised inverse used here differs by a rigid motion from the one of the compliance: match the rows
            modes = system.model.rigid_modes
            rows = np.vstack([system.rows, *system.model.outputs.values()])
            outputs = [system.compliance.output(n, self.forces, self.rigid)[0].real for n in system.model.outputs]
            wanted = np.concatenate([system.compliance.motion(self.forces, self.rigid)[0].real, outputs])
            amplitudes[0] += modes @ np.linalg.lstsq(rows @ modes, wanted - rows @ amplitudes[0].real, rcond=None)[0]
        return amplitudes @ system.expansion.T

    @cached_property
    def excitation(self) -> ComplexArray:
        """Amplitudes of all forces that are given, on the reduced coordinates, ``(n_h, n)``: loads, preloads [N]."""
        nothing = np.zeros(self.problem.model.size, dtype=complex)
        return np.array([self.problem.excitation.get(h, nothing) for h in self.orders])

    @cached_property
    def histories(self) -> tuple[str, ...]:
        """Names that ``history`` knows: the usual ones, and what the laws report besides."""
        reported = [name for _, laws in self.problem.groups for kind in laws.kinds for name in kind.histories]
        return tuple(dict.fromkeys([*HISTORIES, *reported, *self._second_histories]))

    @cached_property
    def _second_histories(self) -> Mapping[str, str]:
        """What ``history`` knows along second tangents: its name there -> along the first; empty in 2-D."""
        if self.problem.model.tangents < 2:
            return {}
        tangential = [name for _, laws in self.problem.groups for name in laws.kinds[1].histories]
        return {SECOND + n: n for n in (*HISTORIES, *tangential) if n not in ("normal_force", "gap")}

    def history(self, name: str, samples: int = 1024) -> RealArray:
        """A quantity of every pair over one period, ``(samples, K_c)``.

        Args:
            name: ``"normal_force"`` (presses where positive), ``"friction_force"`` (as truncated) and
                ``"admissible_friction_force"`` (in the cone), on body A along the tangent [N]; ``"gap"`` (initial gap
                included), ``"slip"`` of A along the tangent, relative to B [m]; ``"slip_velocity"`` [m/s]; or what a
                law of your own reports, zero at other pairs. In 3-D the tangent is the first one, and ``"second_"``
                before a name gives the same along the second: ``"second_slip"``.
            samples: Samples a period, from ``tau = omega t = 0`` on, its end left out.

        Raises:
            ModelError: An unknown name, one that no law reports, or no whole number of samples.
        """
        if name not in self.histories:
            known = self.histories
            raise ModelError(f'no history "{name}"; choose one of {", ".join(known)}{nearest(name, known)}')
        samples = read_samples(samples)
        model, basis = self.problem.model, FourierBasis(self.orders, samples)
        along = "second_tangential" if name in self._second_histories else "tangential"
        name = self._second_histories.get(name, name)
        if name in ("normal_force", "friction_force"):
            direction = "normal" if name == "normal_force" else along
            if direction not in self.pair_forces:
                return np.zeros((samples, model.pairs))
            force = basis.synthesise(self.pair_forces[direction])
            if direction == "normal":  # given harmonics may lie outside those kept
                everywhere = np.arange(model.pairs)
                given = {h: a for h, a in self.problem.system.prescribed.items() if h not in self.orders}
                force += sample_amplitudes(given, everywhere, samples)
            return force
        if name == "gap":
            opening = 0.0 if model.normal is None else basis.synthesise(self.coordinates @ model.normal.T)
            return opening + np.broadcast_to(self.problem.clearance, (samples, model.pairs))
        if name in ("slip", "slip_velocity"):
            if not model.tangents:
                return np.zeros((samples, model.pairs))
            slip = self.slip_amplitudes[along]
            return basis.synthesise(slip if name == "slip" else self._rate * slip)
        reported = np.zeros((samples, model.pairs))
        if name == "admissible_friction_force":
            reported = self.history(SECOND * (along != "tangential") + "friction_force", samples)
        fields = [(law, fields) for law, fields in self.law_fields(basis) if name in fields]
        if not fields and name not in HISTORIES:
            raise ModelError(f'a kind names "{name}" in its histories, and no law of it reports that in fields')
        for law, found in fields:
            if (law.direction == "second_tangential") == (along == "second_tangential"):
                reported[:, law.pairs] = found[name]
        return reported

    def sliding_speed(self, samples: int = 1024) -> RealArray:
        """Speed of sliding at every pair over one period, along both tangents in 3-D, ``(samples, K_c)`` [m/s].

        Zero where the law says that the pair sticks: there the truncated slip velocity rings about zero, which would
        add up over a cycle to a distance that nothing slides. Pairs that are open slide as well, without rubbing.
        Where springs close the truncation, their ends slide: the truncated slip lacks what the springs bend.

        Raises:
            ModelError: No whole number of samples.
        """
        stride = self._find_stride(samples)
        basis = FourierBasis(self.orders, stride * samples)
        velocity = {d: basis.synthesise(self._rate * slip) for d, slip in self.slip_amplitudes.items()}
        slips = np.zeros((basis.samples, self.problem.model.pairs), dtype=bool)
        told = np.zeros(slips.shape[1], dtype=bool)
        for law, fields in self.law_fields(basis):
            if "slipping" in fields:
                slips[:, law.pairs] |= fields["slipping"]
                told[law.pairs] = True
            if "surface_slip" in fields:
                step = np.diff(fields["surface_slip"], axis=0, prepend=fields["surface_slip"][-1:])
                velocity[law.direction][:, law.pairs] = self.problem.frequency * basis.samples * step
        speed = np.hypot.reduce([np.zeros(slips.shape), *velocity.values()])
        return (speed * (slips | ~told))[::stride]

    def _find_stride(self, samples: int) -> int:
        """Evaluations of the laws a sample: laws that remember need as many a period as the solve had, or more."""
        return -(-self.problem.basis.samples // read_samples(samples))

    @cached_property
    def slip_amplitudes(self) -> Mapping[str, ComplexArray]:
        """Amplitudes ``(n_h, K_c)`` of the slip at all pairs by tangential direction [m]."""
        model = self.problem.model
        return {d: self.coordinates @ model.rows(d).T for d in model.tangent_directions}

    @property
    def _rate(self) -> ComplexArray:
        """``(n_h, 1)`` what a derivative by time multiplies amplitudes by [rad/s]."""
        return 1j * self.problem.omega * np.array(self.orders)[:, None]

    def law_fields(self, basis: FourierBasis) -> list[tuple]:
        """What each law reports besides its force, at the samples of ``basis``: ``(law, name -> (n_t, K))``."""
        system = self.problem.system
        if not system.laws:
            return []
        stride = self._find_stride(basis.samples)
        often = FourierBasis(basis.orders, stride * basis.samples)
        motion = system.compliance.motion(self.forces, self.rigid)
        seen = HarmonicBalance(system).sample(self.forces, motion, often)
        reported = [law.fields(motion) for motion, law in zip(seen, system.laws, strict=True)]
        thin = [{name: values[::stride] for name, values in fields.items()} for fields in reported]
        return list(zip(system.laws, thin, strict=True))

    @cached_property
    def pair_forces(self) -> Mapping[str, ComplexArray]:
        """Amplitudes ``(n_h, K_c)`` of the forces at all pairs by direction, bonded and prescribed included [N]."""
        problem, system, model = self.problem, self.problem.system, self.problem.model
        directions = ("normal", *model.tangent_directions)
        found = {d: np.zeros((len(self.orders), model.pairs), dtype=complex) for d in directions}
        held = []
        for pairs, laws in problem.groups:
            for direction in directions:
                rows = system.row_of(direction, pairs)
                if np.all(rows >= 0):
                    found[direction][:, pairs] = self.forces[:, rows]
                elif any(direction in kind.holds(model.tangents) for kind in laws.kinds):
                    held.append((direction, pairs))
        for h, amplitude in system.prescribed.items():
            if h in self.orders:
                found["normal"][self.orders.index(h)] += amplitude
        if held:
            self._recover_bonds(found, held)
        return found

    def _recover_bonds(self, found: dict[str, ComplexArray], held: list[tuple[str, np.ndarray]]) -> None:
        """Forces in bonded pairs: what the equation of motion leaves over."""
        model = self.problem.model
        bonds = np.vstack([model.rows(direction)[pairs] for direction, pairs in held])
        for j, h in enumerate(self.orders):
            w = h * self.problem.omega
            x = self.coordinates[j]
            known = [d for d in found if d != "normal" or model.normal is not None]
            given = self.problem.loads.get(h, 0) + sum(model.rows(d).T @ found[d][j] for d in known)
            left = model.stiffness @ x - w**2 * (model.mass @ x) + 1j * w * (model.damping @ x) - given
            force = np.linalg.lstsq(bonds.T, left, rcond=1e-12)[0]
            start = 0
            for direction, pairs in held:
                found[direction][j, pairs] = force[start : start + pairs.size]
                start += pairs.size

    @cached_property
    def merit(self) -> dict[str, float]:
        """Figures of merit by name; docs/method.md defines each.

        Violations of the laws [m, N, over the largest limit], looked for between the samples as well, where no law is
        enforced; energies over a period [J] and their imbalance [-]; sliding a cycle, a mean over the pairs, and mean
        gap, over those that may part [m]; RMS of outputs in their own units.
        """
        problem, model, count = self.problem, self.problem.model, self.problem.basis.samples
        viscous = self._rate * (self.coordinates @ model.damping.T)
        fine = max(FINE, count)
        gap, normal = self.history("gap", fine), self.history("normal_force", fine)
        friction, unilateral = problem.friction, problem.opens
        along = dict(zip(model.tangent_directions, ("", SECOND), strict=False))  # direction -> before a history's name
        gaps = indicators.measure_separation(self.history("gap", count)[:, unilateral])
        slides = friction > 0
        work = indicators.measure_work(self.excitation, self.coordinates, self.orders)
        dissipated = indicators.measure_work(viscous, self.coordinates, self.orders)
        period = 2 * np.pi / (problem.omega or 1.0)
        rubbed, truncated = 0.0, [np.zeros((fine, np.count_nonzero(slides)))]
        for direction, which in along.items():
            acts = problem.system.row_of(direction, np.arange(model.pairs)) >= 0
            force, speed = (self.history(which + n, count) for n in ("admissible_friction_force", "slip_velocity"))
            rubbed -= period * np.sum(np.mean(force * speed, axis=0)[acts])
            truncated.append((self.history(which + "friction_force", fine) * acts)[:, slides])  # bonds have no cone
        scale = max(abs(work), dissipated + abs(rubbed), np.finfo(float).tiny)
        figures = {
            "penetration": max(0.0, -float(gap[:, unilateral].min(initial=0.0))),
            "tension": max(0.0, -float(normal[:, unilateral].min(initial=0.0))),
            "largest_normal_force": float(normal.max(initial=0.0)),
            "cone_violation": indicators.measure_cone_violation(
                np.hypot.reduce(truncated, axis=0), normal[:, slides], friction[slides]
            ),
            "excitation_work": work,
            "viscous_dissipation": dissipated,
            "friction_dissipation": float(rubbed),
            "energy_error": (work - dissipated - float(rubbed)) / scale,
            "J_T": float(np.mean(indicators.measure_sliding(self.sliding_speed(), period))),
            "J_N": float(np.mean(gaps)) if gaps.size else 0.0,
        }
        for name in model.outputs:
            figures[f"rms_{name}"] = indicators.measure_rms(self.output(name), self.orders)
        return figures

    @cached_property
    def cautions(self) -> tuple[str, ...]:
        """What speaks against trusting a converged solution as it is, a line each."""
        if not self.converged:
            return ()
        merit, coarse = self.merit, []
        exchanged = max(abs(merit["excitation_work"]), merit["viscous_dissipation"] + merit["friction_dissipation"])
        strained = np.abs(self.forces) ** 2 @ self.problem.system.flexibility  # where contact stops all, motion rounds
        moved = np.sum(np.abs(self.excitation * self.coordinates), axis=1)
        swinging = np.pi * float(np.array(self.orders) @ (moved + strained))
        normal = [laws.kinds[0] for _, laws in self.problem.groups]
        tells = all(kind.only_pushes for kind in normal if kind.acts_in(self.problem.model.tangents))  # of truncation
        if tells and abs(merit["energy_error"]) > COARSE_ENERGY and exchanged > LITTLE_EXCHANGE * swinging:
            coarse.append(f"energies are out of balance by {merit['energy_error']:.1%}")
        if tells and self.touches and merit["tension"] > COARSE_TENSION * merit["largest_normal_force"]:
            coarse.append(f"contact pulls by up to {merit['tension']:.3g} N of {merit['largest_normal_force']:.3g} N")
        lines = [f"truncation is coarse: {', '.join(coarse)}; see what more harmonics change"] if coarse else []
        if merit["viscous_dissipation"] < -LITTLE_EXCHANGE * swinging:
            lines.append(f"the damping matrix feeds {-merit['viscous_dissipation']:.3g} J a cycle: was its sign meant?")
        lines += list_ignored(self.problem)
        if self.rigid.size and walks(*self._pose(), DOUBTFUL):
            lines.append(MAY_WALK)
        if self.fallbacks:
            stable = "this one is unstable" if self.unstable else "the stability of this one is not known"
            lines.append(f"found by a fallback: there may be other solutions, and {stable}")
        elif self.unstable:
            lines.append(f"unstable: motions in time leave it{tell_where_to(self.alternates, self.multiplier)}")
        return tuple(lines)

    def list_reservations(self) -> list[str]:
        """What was tried before it was found, and ``cautions``; empty where the first attempt left nothing to say."""
        return [*(f"fallback: {rung}" for rung in self.fallbacks), *self.cautions]

    @cached_property
    def side(self) -> int:
        """-1 where it is unstable as between two folds, else 1; 0: not looked at. See ``stability.py``."""
        return find_side(*self._pose()) if self.converged and self.problem.system.rows.shape[0] else 0

    @cached_property
    def alternates(self) -> bool:
        """Whether motions in time leave it by alternating from period to period; looked at where pairs tap."""
        taps = any(np.any(state.any(axis=0) & ~state.all(axis=0)) for state in self._open)
        return self.converged and taps and alternates(self.problem.system, self.forces, self.rigid)

    @cached_property
    def multiplier(self) -> complex:
        """The largest Floquet multiplier beyond the unit circle, if one is seen, else 0; looked for in small models."""
        problem = replace(self.problem, closure="dashpot") if self.problem.has_springs else self.problem
        looked_at = (
            self.converged and problem.system.rows.shape[0] and self.orders[-1]
        )  # springs remember, dashpots not
        return find_growth(problem.system, self.forces, self.rigid) if looked_at else 0.0

    @property
    def unstable(self) -> bool:
        """Whether a Floquet multiplier is seen beyond the unit circle; not all are. See ``stability.py``."""
        return self.side < 0 or self.alternates or self.multiplier != 0

    def _pose(self) -> tuple[HarmonicBalance, RealArray]:
        """The balance and its unknowns here; in units of these forces, for full stick would take as long as a step."""
        balance = HarmonicBalance(self.problem.system, float(np.linalg.norm(self.forces)) or 1.0)
        return balance, balance.pack(self.forces, self.rigid)

    @cached_property
    def touches(self) -> bool:
        """Whether pairs that may part ever close; True where none may part."""
        return not self._open or not all(np.all(state) for state in self._open)

    @cached_property
    def _open(self) -> list[np.ndarray]:
        """Which pairs are open, ``(n_t, K)``, for each law under which they may part."""
        fields = [seen for law, seen in self.law_fields(self.problem.basis) if law.direction == "normal"]
        return [seen["open"] for seen in fields if "open" in seen]

    def summary(self) -> str:
        """A few lines for people."""
        state = "converged" if self.converged else f"NOT converged ({self.reason})"
        where = "at rest"
        if self.orders[-1]:
            first, last, count = self.orders[0], self.orders[-1], len(self.orders)
            some = "" if count == last - first + 1 else f" ({count} of them)"
            where = f"{self.problem.frequency:g} Hz, harmonics {first}..{last}{some}"
        lines = [
            f"{where}: {state} in {self.iterations} Newton step{'s' * (self.iterations != 1)}, "
            f"{self.unknowns} unknowns, residual {self.residual:.1e}, {self.seconds:.2f} s"
        ]
        if not self.touches:
            told = "no pair ever touches: the bodies vibrate apart"
            if not np.all(self.problem.opens):
                told = "no pair that may part ever touches: the other pairs alone join the bodies"
            lines.append(f"  {told}; are gaps in m, and does a load close them?")
        if self.left_out:
            lines.append(f"  harmonics {', '.join(map(str, self.left_out))} left out: {self.why_left_out}")
        lines += [f"  {line}" for line in self.list_reservations()]
        return "\n".join(lines)
