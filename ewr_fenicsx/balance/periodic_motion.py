"""A periodic motion of a joint: force amplitudes, and the forces, gaps and slips of its pairs that follow from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ewr_fenicsx.balance.balance import HarmonicBalance, pose_at
from ewr_fenicsx.errors import ModelError, nearest
from ewr_fenicsx.given import ComplexArray, RealArray, read_samples
from ewr_fenicsx.laws.cone import FrictionLaw
from ewr_fenicsx.model.receptance import receptance
from ewr_fenicsx.model.restriction import find_bond_forces
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.problem.harmonics import FourierBasis, sample_amplitudes
from ewr_fenicsx.problem.law_claims import read_fields

HISTORIES = ("normal_force", "friction_force", "admissible_friction_force", "gap", "slip", "slip_velocity")
ROUNDED = 1e-12  # share of what forces and loads would cause if none cancelled, below which a speed is their rounding
CREEPS = 10.0  # times as far as its surfaces drift in a period, up to which a pair slides by nothing else: it may turn
SECOND = "second_"  # before the name of a history: along the second tangent of pairs in 3-D
SECOND_HISTORIES = tuple(SECOND + name for name in HISTORIES if name not in ("normal_force", "gap"))


@dataclass(frozen=True, eq=False, repr=False)
class PeriodicMotion:
    """What moves, and the contact forces that go with it; histories are computed when asked for.

    Attributes:
        problem: The contact problem.
        forces: ``(n_h, m)`` complex amplitudes of the unknown contact forces, rows as in ``problem.system`` [N].
        rigid: ``(r,)`` mean rigid coordinates of floating bodies [m].
    """

    problem: ContactProblem
    forces: ComplexArray
    rigid: RealArray

    @property
    def orders(self) -> tuple[int, ...]:
        """Harmonics of every amplitude array."""
        return self.problem.basis.orders

    def pose(self) -> tuple[HarmonicBalance, RealArray]:
        """The balance of its system, in units of its forces, and the unknowns ``(size,)`` that it is."""
        return pose_at(self.problem.system, self.forces, self.rigid)

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
    def row_motion(self) -> ComplexArray:
        """Amplitudes ``(n_h, m)`` of the rows of ``problem.system``, where forces are sought [m]."""
        return self.problem.system.compliance.motion(self.forces, self.rigid)

    @property
    def contact_amplitudes(self) -> tuple[ComplexArray, ComplexArray]:
        """One-sided complex amplitudes of the forces [N] and motions [m] of the same rows, ``(n_h, m)``."""
        return self.forces, self.row_motion

    @cached_property
    def coordinates(self) -> ComplexArray:
        """Amplitudes of the reduced coordinates, ``(n_h, n)``."""
        system = self.problem.system
        amplitudes = np.zeros((len(self.orders), system.model.size), dtype=complex)
        for j, h in enumerate(self.orders):
            wave = system.model.wave_of(h)
            force = system.rows_in(wave).conj().T @ self.forces[j] + system.load.get(h, 0)
            amplitudes[j] = receptance(system.model, h * self.problem.omega, None, force[:, None], wave)[:, 0]
        if self.rigid.size:
            # the generalised inverse used here differs by a rigid motion from the one of the compliance: match the rows
            modes = system.model.rigid_modes
            rows = np.vstack([system.rows, system.model.read_outputs()])
            outputs = [system.compliance.output(n, self.forces, self.rigid)[0].real for n in system.model.outputs]
            wanted = np.concatenate([self.row_motion[0].real, outputs])
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
            opening = 0.0 if model.normal is None else basis.synthesise(self._move_apart("normal"))
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
        add up over a cycle to a distance that nothing slides. Pairs that are open slide as well, without rubbing. Where
        no law says, pairs slide if their kind ``slides``, as in ``contact_state.classify_contact``, and else stick.
        Where springs or dashpots close the truncation, their ends slide: the truncated slip lacks what these give way.
        Pairs that touch the limit now and then without sliding are left with rounding, or creep by what decides their
        mean friction (``mean_friction.py``): zero here as well.

        Raises:
            ModelError: No whole number of samples.
        """
        stride, basis, reported = self._look_at_laws(samples)
        slips = self.find_slipping(basis, reported)
        speed = self._slide(basis, reported, slips, self._press(basis, reported))
        return np.where(slips, np.maximum(0.0, speed), 0.0)[::stride]

    def pressing_force(self, samples: int = 1024) -> RealArray:
        """Force that presses, and wears what slides, at every pair over one period, ``(samples, K_c)`` [N].

        It is the one that the law admits, where the law says it, and so none while a pair is open. There the truncated
        force, of the same harmonics, rings about zero.

        Raises:
            ModelError: No whole number of samples.
        """
        stride, basis, reported = self._look_at_laws(samples)
        return self._press(basis, reported)[::stride]

    def press_and_slide(self, samples: int = 1024) -> tuple[RealArray, RealArray]:
        """``pressing_force`` and ``sliding_speed``, with one look at the laws for both: for means over the period.

        Between sticking and slipping speeds are not cut off, and may be of either sign: about zero in solutions, and in
        what estimates look at, which nearly are, such that in the mean they leave the work of friction. Surfaces at the
        ends of springs, and masses, are followed from sample to sample: theirs are means over the step before.
        """
        stride, basis, reported = self._look_at_laws(samples)
        slips, force = self.find_slipping(basis, reported), self._press(basis, reported)
        speed = self._slide(basis, reported, slips, force)
        for law, fields in reported:
            if "surface_slip" in fields:  # the force at its end would press half a step late
                force[:, law.pairs] = 0.5 * (force + np.roll(force, 1, axis=0))[:, law.pairs]
        return force[::stride], speed[::stride]

    def _look_at_laws(self, samples: int) -> tuple[int, FourierBasis, list[tuple]]:
        """Every which sample of a basis counts, that basis, and what each law reports there, as ``law_fields``."""
        samples = read_samples(samples)
        stride = self._find_stride(samples)
        basis = FourierBasis(self.orders, stride * samples)
        return stride, basis, self.law_fields(basis)

    def _press(self, basis: FourierBasis, reported: list[tuple]) -> RealArray:
        force = np.maximum(0.0, self.history("normal_force", basis.samples))
        for law, fields in reported:
            if "admissible_normal_force" in fields:
                force[:, law.pairs] = fields["admissible_normal_force"]
        return force

    def _slide(self, basis: FourierBasis, reported: list[tuple], slips: np.ndarray, pressing: RealArray) -> RealArray:
        velocity = {d: basis.synthesise(self._rate * slip) for d, slip in self.slip_amplitudes.items()}
        none = np.zeros(slips.shape)
        for law, fields in reported:
            if "surface_slip" in fields:
                step = np.diff(fields["surface_slip"], axis=0, prepend=fields["surface_slip"][-1:])
                velocity[law.direction][:, law.pairs] = self.problem.frequency * basis.samples * step
        moves = np.max(slips * np.hypot.reduce([none, *velocity.values()]), axis=0) > ROUNDED * self.slip_reach
        opposed, limit, normal = none.copy(), none.copy(), self.history("normal_force", basis.samples)
        own = self.problem.basis
        solved = reported if basis.samples == own.samples else self.law_fields(own)
        moves &= ~self._find_creeping(solved)
        for law, force, beyond in self._find_forces_beyond(basis, reported, solved):
            velocity[law.direction][:, law.pairs] += beyond / law.impedance
            opposed[:, law.pairs] -= force * velocity[law.direction][:, law.pairs]
            limit[:, law.pairs] = law.limit({"normal": normal[:, law.pairs]})
        speed = slips * np.hypot.reduce([none, *velocity.values()])
        rubs = np.any(slips & (pressing > 0), axis=0)  # the others rest while they are pressed
        speed = np.divide(opposed, limit, out=speed, where=(limit > 0) & rubs)
        return np.where(moves, speed, 0.0)

    def _find_creeping(self, solved: list[tuple]) -> np.ndarray:
        """``(K_c,)`` which pairs behind dashpots slide by nothing but what their mean equation lets them creep.

        A period brings back what slides: what surfaces drift in one is that creep, under the laws at the samples of the
        solve, ``solved``.
        """
        own, creeps = self.problem.basis, np.zeros(self.problem.model.pairs, dtype=bool)
        speed, drift = np.zeros((own.samples, creeps.size)), np.zeros(creeps.size)
        for law, _, beyond in self._find_forces_beyond(own, solved, solved):
            along = own.synthesise(self._rate * self.slip_amplitudes[law.direction][:, law.pairs])
            along += beyond / law.impedance
            speed[:, law.pairs] = np.hypot(speed[:, law.pairs], along)
            drift[law.pairs] = np.hypot(drift[law.pairs], along.mean(axis=0))
            hangs = bool(self.rigid.size) & (np.asarray(law.static_displacement_row) > 0)  # it may walk
            creeps[law.pairs] = own.has_mean & (law.static_row > 0) & ~hangs
        return creeps & (speed.mean(axis=0) <= CREEPS * drift)

    def _find_forces_beyond(self, basis: FourierBasis, reported: list[tuple], solved: list[tuple]) -> list[tuple]:
        """Of laws whose truncation dashpots close: the law, friction, and what is left of it beyond the harmonics [N].

        These harmonics are those of the solve, by its own samples and what laws report there, ``solved``: where it has
        converged, those of the unknown force.
        """
        own, name, found = self.problem.basis, "admissible_friction_force", []
        for (law, fields), (_, there) in zip(reported, solved, strict=True):
            if isinstance(law, FrictionLaw) and not law.closes and law.impedance is not None and name in fields:
                kept = own.to_amplitudes(own.project(there[name]))
                if own.has_mean:
                    rows = self.problem.system.row_of(law.direction, law.pairs)
                    mean, place = self.forces[0, rows].real, self.row_motion[0, rows].real
                    besides = law.static_force_row * mean + law.static_displacement_row * place
                    kept[0] = kept[0] - besides / law.static_row if law.static_row else mean
                found.append((law, fields[name], fields[name] - basis.synthesise(kept)))
        return found

    def find_slipping(self, basis: FourierBasis, reported: list[tuple]) -> np.ndarray:
        """Where nothing holds the pairs, ``(n_t, K_c)`` bool."""
        slips = np.zeros((basis.samples, self.problem.model.pairs), dtype=bool)
        for pairs, laws in self.problem.groups:
            slips[:, pairs] = any(kind.slides for kind in laws.kinds)
        for law, fields in reported:
            for name in {"slipping", "open"} & fields.keys():
                slips[:, law.pairs] |= np.asarray(fields[name], dtype=bool)
        return slips

    @cached_property
    def slip_reach(self) -> RealArray:
        """``(K_c,)`` speed along the rows of friction that forces and loads would cause if none cancelled [m/s]."""
        system, model = self.problem.system, self.problem.model
        bound = np.sum(np.abs(self._rate) * system.compliance.bound_rows(self.forces), axis=0)
        along = [system.spread(bound, direction) for direction in model.tangent_directions]
        return np.max([np.zeros(model.pairs), *along], axis=0)

    def _find_stride(self, samples: int) -> int:
        """Evaluations of the laws a sample: laws that remember need as many a period as the solve had, or more."""
        return -(-self.problem.basis.samples // samples)

    @cached_property
    def slip_amplitudes(self) -> Mapping[str, ComplexArray]:
        """Amplitudes ``(n_h, K_c)`` of the slip at all pairs by tangential direction [m]."""
        return {direction: self._move_apart(direction) for direction in self.problem.model.tangent_directions}

    def _move_apart(self, direction: str) -> ComplexArray:
        """Amplitudes ``(n_h, K_c)`` of what the model's rows of a direction say of all pairs: opening, or slip [m].

        Where a force is sought, the compliance has told; the whole model need not be moved for that.
        """
        model, system = self.problem.model, self.problem.system
        apart, sought = system.spread(self.row_motion, direction), system.row_of(direction, np.arange(model.pairs)) >= 0
        if not np.all(sought):
            for j, h in enumerate(self.orders):
                apart[j, ~sought] = model.rows(direction, model.wave_of(h))[~sought] @ self.coordinates[j]
        return apart

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
        seen = HarmonicBalance(system).sample(self.forces, self.row_motion, often)
        reported = [read_fields(law, motion) for motion, law in zip(seen, system.laws, strict=True)]
        thin = [{name: values[::stride] for name, values in fields.items()} for fields in reported]
        return list(zip(system.laws, thin, strict=True))

    @cached_property
    def pair_forces(self) -> Mapping[str, ComplexArray]:
        """Amplitudes ``(n_h, K_c)`` of the forces at all pairs by direction, bonded and prescribed included [N]."""
        system = self.problem.system
        found = {d: system.spread(self.forces, d) for d in ("normal", *self.problem.model.tangent_directions)}
        for h, amplitude in system.prescribed.items():
            if h in self.orders:
                found["normal"][self.orders.index(h)] += amplitude
        if self.problem.bonds:
            self._recover_bonds(found)
        return found

    def _recover_bonds(self, found: dict[str, ComplexArray]) -> None:
        """Forces in bonded pairs: what the equation of motion leaves over."""
        model, bonds = self.problem.model, self.problem.bonds
        elastic, viscous, inertial = (
            model.react(name, self._rate**power * self.coordinates, self.orders)
            for power, name in enumerate(("stiffness", "damping", "mass"))
        )
        left = elastic + viscous + inertial
        known = [d for d in found if d != "normal" or model.normal is not None]
        for j, h in enumerate(self.orders):
            left[j] -= self.problem.loads.get(h, 0)
            left[j] -= sum(model.rows(d, model.wave_of(h)).conj().T @ found[d][j] for d in known)
        for (direction, pairs), force in zip(bonds, find_bond_forces(model, bonds, left.T), strict=True):
            found[direction][:, pairs] = force.T
