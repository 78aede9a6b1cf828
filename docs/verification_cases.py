"""The cases of docs/verification.md with closed forms: what each yields, and what is exact.

Models and closed forms are those of tests/verification; `generate_verification.py` makes the page.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / part) for part in ("benchmarks", "tests", "tests/verification")]

import test_bar_against_wall as bar  # noqa: E402
import test_bladed_disk as wheel  # noqa: E402
import test_den_hartog as den_hartog  # noqa: E402
import test_den_hartog_resonances as resonances  # noqa: E402
import test_finite_elements as elements  # noqa: E402
import test_held_by_friction as held  # noqa: E402
import test_hertz as hertz  # noqa: E402
import test_hertz_in_space as sphere  # noqa: E402
import test_jenkins as jenkins  # noqa: E402
import test_rebound as rebound  # noqa: E402
import test_reduction as reduction  # noqa: E402
import test_ring_of_masses as masses  # noqa: E402
import test_shrink_fit as shrink  # noqa: E402
import test_time_integration as stepping  # noqa: E402
import test_two_rubbing_modes as modes  # noqa: E402
import test_varying_normal_load as varying  # noqa: E402
import test_wear as wear  # noqa: E402

ORDER = 31  # of the closed forms


@dataclass(frozen=True)
class Row:
    """One quantity of a case; where the closed form is a history, it has no single exact value but an error."""

    quantity: str
    exact: float | None
    ours: float | None
    error: str


def compare(quantity: str, exact: float, ours: float) -> Row:
    """A row with its error: relative in percent, or absolute where zero is exact."""
    if exact == 0:
        return Row(quantity, 0.0, float(ours), f"{ours:.1e}")
    percent = 100 * (ours / exact - 1)
    return Row(quantity, float(exact), float(ours), f"{percent:+.0f} %" if abs(percent) >= 10 else f"{percent:+.2g} %")


def bound(quantity: str, error: float) -> Row:
    """A row that has only an error, a relative one."""
    return Row(quantity, None, None, f"{100 * error:.2g} %" if error > 1e-6 else f"{error:.1e}")


def rub(beta: float, friction: float) -> Iterator[Row]:
    """Amplitude, first friction harmonic and friction work a cycle of the dry oscillator."""
    den_hartog.rub.cache_clear()
    solution, exact = den_hartog.rub(beta, friction, ORDER), den_hartog.exact_amplitude(beta, friction)
    yield compare("amplitude", exact, den_hartog.largest_slip(solution))
    for name, m in (("first", 1), ("third", 3), ("fifth", 5)):
        found = abs(solution.forces[solution.orders.index(m), 0])
        yield compare(f"friction force, {name} harmonic", 4 * friction / (m * np.pi), found)
    yield compare("friction work a cycle", 4 * friction * exact, solution.merit["friction_dissipation"])


def rub_with_inertia(beta: float, friction: float) -> Iterator[Row]:
    """Amplitude and sliding a cycle of the dry oscillator whose mass closes the truncation."""
    solution, exact = den_hartog.rub_with_inertia(beta, friction, ORDER), den_hartog.exact_amplitude(beta, friction)
    yield compare("amplitude", exact, den_hartog.largest_slip(solution))
    yield compare("sliding a cycle", 4 * exact, solution.merit["J_T"])


def begin_to_stop(beta: float, boundary: float) -> Iterator[Row]:
    """Largest friction at which the dry oscillator, closed by its mass, does not stop within the period."""
    yield compare("largest x_f / a without stops", boundary, den_hartog.find_boundary(beta, boundary))


def rub_near_a_fraction(beta: float, friction: float, second: complex) -> Iterator[Row]:
    """Amplitude of the dry oscillator where its closed form degenerates."""
    solution = resonances.solve_and_check(resonances.pose(beta, friction, second))
    yield compare("amplitude", den_hartog.exact_amplitude(beta, friction), resonances.find_amplitude(solution))


def rub_beside_a_mode(beta: float) -> Iterator[Row]:
    """First harmonics of two masses by few harmonics, against time stepping."""
    modes.step.cache_clear()
    for closure, name in (("mass", "mass"), ("dashpot", "dashpots")):
        for kept in ((1, 3), (1, 3, 5)):
            error = modes.find_error(beta, kept, closure)
            yield bound(f"first harmonics, of {' '.join(map(str, kept))} closed by {name}", error)


def hold_by_friction(damping: float, suspension: float) -> Iterator[Row]:
    """Amplitude of a block that only friction holds, or a soft suspension, at the resonance of the stuck joint."""
    problem, amplitude = held.shaken_block(damping, suspension)
    yield compare("amplitude", amplitude, abs(held.solve(problem).output("x")[1]))


def step_stuck_node(steps: int) -> Iterator[Row]:
    """The same of time stepping, where the node that sticks has no mass."""
    problem, amplitude = held.stuck_node()
    steady = held.integrate(problem, held.solve(problem), steps, 2000, tolerance=1e-7)
    yield compare("amplitude", amplitude, abs(steady.output("x")[1]))


def drive_jenkins(amplitude: float) -> Iterator[Row]:
    """Work a cycle and equivalent stiffness of the Jenkins element."""
    jenkins.drive.cache_clear()
    solution = jenkins.drive(amplitude, ORDER)
    stiffness = np.real(jenkins.SPRING * solution.output("stretch")[0] / solution.output("driven")[0])
    yield compare("work a cycle", jenkins.exact_work(amplitude), solution.merit["friction_dissipation"])
    yield compare("equivalent stiffness", jenkins.exact_stiffness(amplitude), stiffness)


def vary_load(ripple: float, phase: float, static_friction: str) -> Iterator[Row]:
    """Mean friction force and displacement under a varying normal load."""
    x, friction = varying.step_to_the_steady_state(ripple, phase)
    varying.balance_harmonics.cache_clear()
    solution = varying.balance_harmonics(ripple, phase, static_friction, ORDER)
    yield compare("mean friction force", friction.mean(), solution.forces[0, 0].real)
    yield bound("displacement over the period, largest", varying.displacement_error(solution, x))


def press_bar(highest: int) -> Iterator[Row]:
    """Mean force, gap and force of the bar against the wall."""
    bar.press.cache_clear()
    solution = bar.press(highest)
    gap, force = bar.errors(solution)
    yield compare("mean contact force", bar.MEAN, solution.forces[0, 0].real)
    yield bound("gap over the period, rms", gap)
    yield bound("contact force over the period, rms", force)


def press_undamped_bar(highest: int) -> Iterator[Row]:
    """Swing of the end of the bar without its dashpot, where no contact force moves the end at the first harmonic."""
    bar.press_undamped.cache_clear()
    solution = bar.press_undamped(np.pi / 2, highest)
    yield compare("swing of the end", bar.RIPPLE / (np.pi / 2), bar.find_swing(solution))


def strike_stop(frequency: float, guess: tuple[float, float]) -> Iterator[Row]:
    """Mean and first harmonic of a mass that hits a stop, and what two sets of harmonics extrapolate to."""
    exact = 1e6 * rebound.find_impacting_motion(frequency, 1.0, guess)
    few, more = (1e6 * rebound.balance_rebound(frequency, n) for n in (20, 40))
    for name, found in (("N = 40", more), ("N to infinity, from 20 and 40", 2 * more - few)):
        yield compare(f"mean position [µm], {name}", exact[0].real, found[0].real)
        yield bound(f"first harmonic, amplitude and phase, {name}", abs(found[1] - exact[1]) / abs(exact[1]))


def press_cylinder(pairs: int) -> Iterator[Row]:
    """Largest pressure and approach of the cylinder on a plane."""
    solution = hertz.press(pairs)
    _, _, spread = hertz.pressure_errors(pairs)
    pressure = solution.history("normal_force", 4)[0] * pairs / (2 * hertz.REACH)
    yield compare("largest pressure", hertz.exact_pressure(pairs).max(), pressure.max())
    yield compare("half-width of contact", 1, hertz.REACH * np.mean(pressure > 1e-9))
    yield compare("approach", hertz.approach(hertz.FORCE), -solution.output("height")[0].real)
    yield bound("pressure, rms, of p0", spread)


def rub_cylinder(pairs: int, highest: int) -> Iterator[Row]:
    """Tangential force, tractions and work a cycle of the cylinder that is rubbed back and forth."""
    hertz.rub.cache_clear()
    solution = hertz.rub(pairs, highest)
    force = -solution.history("admissible_friction_force", 4).sum(axis=1)
    errors = hertz.traction_errors(pairs, highest)
    yield compare("largest tangential force", hertz.LARGEST, force[0])
    yield compare("tangential force where the shift is zero", hertz.exact_force_without_shift(), force[1])
    yield bound("traction at the peak, largest, of mu p0", errors["traction at the peak"])
    yield bound("traction where the shift is zero, largest", errors["traction without shift"])
    yield compare("work a cycle", hertz.exact_work(), solution.merit["friction_dissipation"])


def press_sphere(across: int) -> Iterator[Row]:
    """Largest pressure and approach of the sphere on a plane."""
    solution, exact = sphere.press(across), sphere.PRESSURE * sphere.shape_hertz(across, 1.0)
    _, _, spread = sphere.pressure_errors(across)
    pressure = solution.history("normal_force", 4)[0] / sphere.size_of(across) ** 2
    yield compare("largest pressure", exact.max(), pressure.max())
    yield compare("approach", sphere.approach(sphere.FORCE), -solution.output("height")[0].real)
    yield bound("pressure, rms, of p0", spread)


def rub_sphere(across: int, highest: int) -> Iterator[Row]:
    """Tangential force, tractions and work a cycle of the sphere that is rubbed along a line at 30 degrees."""
    sphere.rub.cache_clear()
    errors, solution = sphere.traction_errors(across, highest, 30.0), sphere.rub(across, highest, 30.0)
    yield bound("largest tangential force", errors["force at the peak"])
    yield bound("traction at the peak, rms, of mu p0", errors["traction at the peak"])
    yield bound("traction across the line, largest, of mu p0", errors["traction across"])
    yield compare("work a cycle", sphere.exact_work(), solution.merit["friction_dissipation"])


def shrink_fit(around: int, across: int) -> Iterator[Row]:
    """Pressure of an interference at some speeds, in shares of the one that takes it."""
    with TemporaryDirectory() as folder:
        for share in (1e-3, 0.5):
            speed = share * shrink.find_loosening_speed()
            pressure, _ = shrink.measure_pressure(shrink.fit(Path(folder), speed, around, across))
            yield compare(f"pressure at {share:g} of the loosening speed", shrink.find_pressure(speed), pressure)


def bend_beam() -> Iterator[Row]:
    """Bending and axial frequencies of the cantilever, quadratic elements, Poisson's ratio zero."""
    material = elements.Material(elements.TITANIUM.young, 0.0, elements.TITANIUM.density)
    exact = elements.timoshenko_cantilever(material, elements.LENGTH, elements.HEIGHT, 2)
    found = elements.solve_cantilever(2, 4, 0.0)
    for k in range(2):
        yield compare(f"bending frequency {k + 1} [Hz], Timoshenko", exact[k], found[k])
    axial = np.sqrt(material.young / material.density) / (4 * elements.LENGTH)
    yield compare("axial frequency [Hz]", axial, found[2])


def refine_mesh(degree: int) -> Iterator[Row]:
    """Rate at which the axial frequency converges when the mesh is halved."""
    axial = np.sqrt(elements.TITANIUM.young / elements.TITANIUM.density) / (4 * elements.LENGTH)
    coarse, fine = (elements.solve_cantilever(degree, columns, 0.0)[2] / axial - 1 for columns in (1, 2))
    yield compare("rate in the mesh size, axial frequency", 2 * degree, np.log2(coarse / fine))


def free_body() -> Iterator[Row]:
    """Rigid modes of a free body, and the patch test."""
    structure = elements.assemble(elements.TWO_BLOCKS, {"welded": True, "skew": 0.01}, degree=2, clamp=())
    modes = elements.solve_modes(structure.stiffness, structure.mass, 5, shift=-((2 * np.pi * 1000) ** 2))
    squares = modes.frequency**2
    yield compare("largest rigid eigenvalue over the first elastic one", 0, np.abs(squares[:3] / squares[3]).max())


def patch() -> Iterator[Row]:
    """The static patch test, worst of plane stress and strain, both degrees, triangles and quadrilaterals."""
    kinds = [(plane, degree, quads) for plane in ("stress", "strain") for degree in (1, 2) for quads in (True, False)]
    worst = np.max([elements.stretch_patch(*kind) for kind in kinds], axis=0)
    for quantity, error in zip(("energy", "force at inner nodes", "traction on the tip"), worst, strict=True):
        yield bound(f"{quantity}, largest error", error)


def weld_joint() -> Iterator[Row]:
    """The fir tree with every pair bonded against the mesh whose nodes are merged."""
    tied = elements.assemble(elements.FIR_TREE)
    merged = elements.assemble(elements.GEOMETRY / "welded_fir_tree.py")
    bonded = elements.full_stick_modes(tied, elements.pair_interface(tied), 4).frequency
    welded = elements.solve_modes(*elements.hold_clamp(merged), 4).frequency
    yield compare("first full-stick frequency [Hz]", welded[0], bonded[0])
    yield bound("first four, largest", np.abs(bonded / welded - 1).max())


def reduce_fir_tree() -> Iterator[Row]:
    """Compliance of the joint: reduced against sparse, to five times the first mode."""
    structure, interface = reduction.assemble(reduction.FIR_TREE)
    matrices = reduction.full_matrices(structure, interface)
    frequencies = reduction.FIRST_MODE * np.arange(1, 6)
    exact = [reduction.evaluate_compliance(matrices, f) for f in frequencies]
    for options in ({"modes": 5}, {"modes": 20}, {}, {"modes": 80}):
        reduced = reduction.reduce_structure(structure, interface, **options)
        model = reduction.reduced_matrices(reduced.model)
        found = [reduction.evaluate_compliance(model, f) for f in frequencies]
        worst = max(reduction.joint_error(one, other) for one, other in zip(found, exact, strict=True))
        name = f"{len(reduced.fixed_interface_frequencies)} modes{'' if options else ' (the default)'}"
        yield bound(f"compliance of the joint at 1 to 5 times 1090 Hz, {name}", worst)


def keep_all_modes() -> Iterator[Row]:
    """The reduction of two blocks with every mode kept."""
    shape = {"columns": 2, "blade_rows": 3, "disk_rows": 2, "skew": 0.01, "inclination": 20.0}
    structure, interface = reduction.assemble(reduction.TWO_BLOCKS, shape, pull=-1000.0, degree=2)
    matrices = reduction.full_matrices(structure, interface)
    reduced = reduction.reduce_structure(structure, interface, modes=matrices[0].shape[0] - 4 * len(interface.area))
    model = reduction.reduced_matrices(reduced.model)
    for frequency in (500.0, 40000.0):
        exact, found = (reduction.evaluate_compliance(one, frequency) for one in (matrices, model))
        yield bound(f"compliance at {frequency:g} Hz", reduction.joint_error(found, exact))


def find_waves(sectors: int) -> Iterator[Row]:
    """Frequencies of the waves round a ring of masses and springs."""
    yield bound("frequencies of all waves, largest", masses.frequency_error(sectors))


def rub_in_turn(beta: float, friction: float) -> Iterator[Row]:
    """Amplitude and friction work a cycle of masses that rub on both neighbours, which move against them."""
    solution, exact = masses.rub_in_turn(beta, friction, ORDER), den_hartog.exact_amplitude(beta, friction)
    yield compare("amplitude", exact, den_hartog.largest_slip(solution) / 2)
    yield compare("friction work a cycle and mass", 4 * friction * exact, solution.merit["friction_dissipation"])


def close_wheel(kind: str, sectors: int) -> Iterator[Row]:
    """A sector against the whole wheel, all modes kept: modes of full stick, and a blade's tip in slip and lift-off."""
    with TemporaryDirectory() as folder:

        def build(whole: bool, modes: int):
            case = {"sectors": sectors, "whole": whole, "engine_order": 1, "modes": modes}
            return wheel.build_chain(wheel.write_wheel(Path(folder), kind, **case)).reduction

        one, every = (build(whole, build(whole, 1).most_modes) for whole in (False, True))
    waves = [np.sqrt(wheel.solve_stuck(one.model, wave)[0]) for wave in range(sectors)]
    exact = np.sqrt(wheel.solve_stuck(every.model)[0])
    yield bound(
        "full-stick frequencies of all waves, largest", np.abs(np.sort(np.concatenate(waves)) / exact - 1).max()
    )
    mine, theirs = (wheel.solve(wheel.pose(r.model, sectors)).output("tip_0") for r in (one, every))
    yield bound("tip where flanks slip and lift off", np.abs(mine - theirs).max() / np.abs(theirs).max())


def step_den_hartog() -> Iterator[Row]:
    """Den Hartog's amplitude by time stepping, the mean over the second half of the run."""
    result = stepping.integrate_den_hartog(0.8, 0.4, 3200, 200)
    x = result.transient("x")[1:].reshape(-1, 3200)[result.periods // 2 :]
    yield compare("amplitude", stepping.den_hartog_amplitude(0.8, 0.4), np.mean(np.ptp(x, axis=1)) / 2)


def step_block() -> Iterator[Row]:
    """Distance and time in which a thrown block comes to rest."""
    result, (_, gravity, friction, speed) = stepping.slide_block(970), stepping.BLOCK.values()
    moving = np.flatnonzero(result.history("slip_velocity")[:, 0] > 1e-9)[-1] + 1
    yield compare("distance", speed**2 / (2 * friction * gravity), result.transient("x")[-1])
    yield compare("time", speed / (friction * gravity), moving * result.scheme.dt)


def step_bar() -> Iterator[Row]:
    """A bar of 100 elements that hits a wall."""
    result = stepping.throw_bar(100)
    dt, impulse = result.scheme.dt, result.last.impulses[:, 0]
    instant = dt * (np.arange(impulse.size) + 0.5)
    yield compare("impulse", 2, impulse.sum())
    yield compare("contact force", 1, np.mean(impulse[(instant > 0.2) & (instant < 1.8)]) / dt)
    yield compare("duration of contact", 2, dt * np.sum(impulse > 0.5 * dt))


def wear_evenly() -> Iterator[Row]:
    """Depth and volume that a flat punch loses, cycle by cycle."""
    cycles = 50
    history, exact = wear.evolve_wear(wear.punch(), cycles, wear.COEFFICIENT), wear.exact_depth(cycles)
    yield compare("depth [nm]", 1e9 * exact, 1e9 * history.depth[-1].max())
    yield compare("volume [mm3]", 1e9 * exact * wear.AREA * wear.PAIRS, 1e9 * history.total_volume[-1])


def wear_crown(cycles: int, jump: wear.Tolerance | None, exact: float) -> Iterator[Row]:
    """What a rounded punch still has of its first differences of pressure."""
    history = wear.evolve_wear(wear.punch(wear.CROWN), cycles, wear.COEFFICIENT, jump, keep_every=100)
    yield compare(f"differences of pressure left, {history.solves} solves", exact, wear.differences_left(history)[-1])


def limit_jumps() -> Iterator[Row]:
    """Longest stable explicit jump, and what jumps on either side of it do to differences of the wear rate."""
    solution = wear.solve(wear.punch(wear.CROWN))
    stiffness = wear.find_wear_stiffness(solution, np.full(wear.PAIRS, wear.COEFFICIENT))
    yield compare("longest stable jump, cycles", 2 / wear.DECAY, wear.find_explicit_limit(stiffness))
    for share in (0.9, 1.1):
        differences = wear.jump_by_euler(share)
        factor = np.vdot(differences[-2], differences[-1]) / np.vdot(differences[-2], differences[-2])
        yield compare(f"factor of differences a jump, at {share} of it", 1 - 2 * share, factor)


Case = tuple[str, Callable[..., Iterator[Row]], tuple]
SECTIONS: dict[str, list[Case]] = {
    "Harmonic balance against closed forms": [
        *(
            (f"Den Hartog, beta = {beta}, x_f / a = {share}", rub, (beta, share))
            for beta, share, *_ in den_hartog.TABLE
        ),
        *(
            (f"Den Hartog, beta = {beta}, x_f / a = {share}, closed by the mass", rub_with_inertia, (beta, share))
            for beta, share, *_ in den_hartog.TABLE
        ),
        *(
            (f"Den Hartog, beta = {beta}, where stops begin, closed by the mass", begin_to_stop, (beta, boundary))
            for beta, boundary in {row[0]: row[3] for row in den_hartog.TABLE}.items()
        ),
        ("Den Hartog, beta = 0.5 + 1e-9, x_f / a = 0.1, asymmetric", rub_near_a_fraction, (0.5 + 1e-9, 0.1, 1e-9)),
        ("Den Hartog, beta = 1/3 + 0.001, x_f / a = 0.002", rub_near_a_fraction, (1 / 3 + 1e-3, 0.002, 0.0)),
        *(
            (f"Two masses, third harmonic near the second mode, beta = {beta}", rub_beside_a_mode, (beta,))
            for beta in modes.DRIVEN
        ),
        *(
            (f"Block at its resonance, {held_by}, damping {damping:g}", hold_by_friction, (damping, suspension))
            for held_by, suspension in (("held by friction alone", 0.0), ("on a soft suspension", 1e3))
            for damping in (2e-3, 2e-4)
        ),
        *((f"Jenkins element, X = {amplitude}", drive_jenkins, (amplitude,)) for amplitude in jenkins.AMPLITUDES[1:]),
        *(
            (
                f"Varying normal load, ripple {ripple}, phase {phase}, mean friction {kind}",
                vary_load,
                (ripple, phase, kind),
            )
            for ripple, phase in varying.CASES
            for kind in ("resolved", "zero")
        ),
        *((f"Bar pressed on a wall, N = {n}", press_bar, (n,)) for n in (5, 9, 17, 33)),
        *((f"Undamped bar on a wall, quarter waves, N = {n}", press_undamped_bar, (n,)) for n in (5, 17)),
        *(
            (f"Mass that hits a stop at {frequency:g} Hz, nothing lost", strike_stop, (frequency, guess))
            for frequency, guess, _ in rebound.CASES
        ),
        *((f"Hertz, {pairs} pairs", press_cylinder, (pairs,)) for pairs in (24, 96)),
        *((f"Cattaneo and Mindlin, {p} pairs, N = {n}", rub_cylinder, (p, n)) for p, n in ((24, 15), (48, 31))),
        *((f"Shrink fit that turns, {n} pairs", shrink_fit, (n, n // 6)) for n in (24, 48)),
        *((f"Hertz, a sphere, {n} patches across", press_sphere, (n,)) for n in (12, 24)),
        *((f"Cattaneo and Mindlin, a sphere, 12 patches across, N = {n}", rub_sphere, (12, n)) for n in (9, 15)),
    ],
    "Wear against closed forms": [
        ("Uniform pressure and slip, 50 cycles", wear_evenly, ()),
        ("Winkler foundation, 400 cycles one by one", wear_crown, (400, None, (1 - wear.DECAY) ** 400)),
        *(
            (
                f"Winkler foundation, 5000 cycles in {'damped' if damped else 'explicit'} jumps",
                wear_crown,
                (5000, wear.Tolerance(share=1e-3, damped=damped), np.exp(-5000 * wear.DECAY)),
            )
            for damped in (True, False)
        ),
        ("Winkler foundation, both sides of the explicit limit", limit_jumps, ()),
    ],
    "Finite elements and reduction": [
        ("Cantilever, quadratic elements", bend_beam, ()),
        ("Cantilever, linear elements halved", refine_mesh, (1,)),
        ("Cantilever, quadratic elements halved", refine_mesh, (2,)),
        ("Free body", free_body, ()),
        ("Patch test", patch, ()),
        ("Fir tree bonded, against one welded mesh", weld_joint, ()),
        ("Fir tree reduced, against sparse matrices", reduce_fir_tree, ()),
        ("Two blocks reduced, all modes kept", keep_all_modes, ()),
    ],
    "Rings of sectors": [
        *((f"{sectors} masses and springs", find_waves, (sectors,)) for sectors in (6, 100)),
        *(
            (f"Masses that rub in turn, beta = {beta}, x_f / a = {share}", rub_in_turn, (beta, share))
            for beta, share in ((0.8, 0.4), (1.25, 0.3), (0.6, 0.2))
        ),
        ("Four sectors of a bladed wheel, plane", close_wheel, ("plane", 4)),
        ("Four sectors of a bladed wheel with shrouds that touch, plane", close_wheel, ("shrouds", 4)),
        ("Three sectors of a bladed wheel, solid", close_wheel, ("solid", 3)),
    ],
    "Time stepping against closed forms": [
        ("Den Hartog, beta = 0.8, x_f / a = 0.4, 3200 steps", step_den_hartog, ()),
        ("Block that slides to rest, 970 steps", step_block, ()),
        ("Node without mass that sticks, 800 steps", step_stuck_node, (800,)),
        ("Bar that hits a wall, 100 elements, 1600 steps", step_bar, ()),
    ],
}
NOTES = {
    "Harmonic balance against closed forms": f"""N = {ORDER} where the case does not say, and 15 where Den Hartog's
form degenerates: motions without stops are a continuum at beta = 1/2, and vanish at 1/3. Two masses are held against
time stepping. The reference under a varying normal load is a fine time integration of its own, in the test; there
`static_friction = "zero"`, the paper's, is off by the whole mean friction force whatever N, and `"resolved"` converges.
A mass that hits a stop tends to the motion that loses nothing as slowly as `1/N`.""",
    "Wear against closed forms": """A rigid punch on a Winkler foundation. Single cycles leave `1 - 4 k_w k X` of
the pressure's differences each, short jumps `exp(-4 k_w k X)` a cycle; explicit jumps beyond their limit turn them and
make them grow.""",
    "Rings of sectors": """One sector for all. Masses that move against both neighbours rub as Den Hartog's single one
does. The wheel is meshed and solved as a whole, without any cyclic symmetry; its samples are a multiple of its
sectors.""",
    "Time stepping against closed forms": """First order where velocities jump: these errors are of the size of one step
or one element.""",
}
