# %% [markdown]
# # Choose your effects
# One bolted lap joint, from two beams that are one piece to separation, friction and wear at once. An effect that is
# off costs nothing: no unknown, no row, no Newton iteration. A table puts unknowns, time and result side by side. In
# the end the harmonics are chosen as well: those that an accuracy needs.

# %%
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from ewr_fenicsx import ContactLaws, load_scene, solve, solve_to_accuracy
from ewr_fenicsx.solution.contact_state import OPEN, SLIP, classify_contact
from ewr_fenicsx.structure.chain import build_chain, pose_problem

HERE = Path(__file__).parent

# %% [markdown]
# ## One model
# The scene has separation and friction. Its reduced model is built once; what follows changes only the laws.

# %%
scene = load_scene(HERE / "bolted_lap.toml")
chain = build_chain(scene)
model = chain.reduction.model
everything = pose_problem(scene, model, chain.interface)
pairs, coefficients = model.pairs, everything.basis.coefficients
rows = []


def note(name, solution, seconds):
    """Notes what a solution took, and what it is: how far the end moves, and what friction dissipates."""
    amplitude, loss = abs(solution.output("end")[solution.orders.index(1)]), solution.merit["friction_dissipation"]
    rows.append((name, solution.unknowns, solution.iterations, 1e3 * seconds, 1e3 * amplitude, loss))


def step(name, problem):
    """Solves a problem and notes what it took."""
    solve(problem)  # once to warm up: the time below is that of the solve alone
    problem = replace(problem)
    begin = time.perf_counter()
    solution = solve(problem)
    note(name, solution, time.perf_counter() - begin)
    return solution


# %% [markdown]
# ## Bonded: one linear solve a harmonic
# The two beams are welded over the lap. The contact rows leave the model; there is nothing for Newton to do.

# %%
bonded = step("bonded", replace(everything, laws=ContactLaws("bonded", "bonded")))
assert bonded.unknowns == 0 and bonded.iterations == 0

# %% [markdown]
# ## Sliding without friction
# The beams may slide on one another but not part: still linear, and softer.

# %%
sliding = step("sliding, no friction", replace(everything, laws=ContactLaws("bonded", "frictionless")))
assert sliding.unknowns == 0

# %% [markdown]
# ## Friction where nothing opens
# Friction must know the normal force, so a normal bond under friction keeps its row: two unknown forces a pair.

# %%
rubbing = step("friction, no opening", replace(everything, laws=ContactLaws("bonded", "coulomb", friction=0.3)))
assert rubbing.unknowns == 2 * pairs * coefficients

# %% [markdown]
# ## Separation
# One unknown force in the normal direction of every pair; tangentially bonded or free.

# %%
opening = step("separation, stuck", replace(everything, laws=ContactLaws("unilateral", "bonded")))
free = step("separation, no friction", replace(everything, laws=ContactLaws("unilateral", "frictionless")))
assert opening.unknowns == free.unknowns == pairs * coefficients
assert (classify_contact(free, 256) == OPEN).any()

# %% [markdown]
# ## Separation and friction
# Both at every pair: sticking under the washers, slipping beside them, gaping farther out. Rows of pairs that do one
# thing throughout the period are eliminated before the dense solve.

# %%
both = step("separation and friction", everything)
state = classify_contact(both, 512)
assert both.unknowns == 2 * pairs * coefficients
sticks, slips = (state == 1).all(axis=0), (state == SLIP).any(axis=0)
print(
    f"{sticks.sum()} pairs stick throughout, {slips.sum()} slip for a while, {(state == OPEN).any(axis=0).sum()} open"
)
assert sticks.any() and slips.any()
paper = step("mean friction set to zero", replace(everything, laws=replace(everything.laws, static_friction="zero")))
assert paper.unknowns == both.unknowns - pairs

# %% [markdown]
# ## Some flanks only
# The left third of the lap bonded (say, glued): only the pairs beside it have unknowns.

# %%
glued = np.arange(pairs // 3)
between = np.setdiff1d(np.arange(pairs), glued)
laws = [(glued, ContactLaws("bonded", "bonded")), (between, everything.laws)]
mixed = step("left third glued", replace(everything, laws=laws))
assert mixed.unknowns == 2 * between.size * coefficients

# %% [markdown]
# ## Nothing oscillates
# Without the shaker the same scene is a static contact problem.

# %%
rest = step("at rest", replace(everything, load={0: model.load[0]}))
assert rest.unknowns == 2 * pairs

# %% [markdown]
# ## Wear
# Wear is a slow history of such solves. Its module is imported here and nowhere else, and its state is one depth a
# pair.

# %%
from ewr_fenicsx import evolve_wear  # noqa: E402

begin = time.perf_counter()
worn = evolve_wear(everything, cycles=20, coefficient=1e-11)
last = worn.solutions[-1]
name = f"and wear, {worn.solves} solves"
note(name, last, time.perf_counter() - begin)
assert worn.depth[-1].max() > 0
unworn = evolve_wear(replace(everything, wear=np.zeros(pairs)), cycles=2, coefficient=1e-30)
np.testing.assert_allclose(unworn.solutions[-1].output("end"), both.output("end"), rtol=1e-7)

# %% [markdown]
# ## What it cost, and what it gave
# Friction lies between its limits: with a coefficient that tends to zero the joint is the frictionless one. The more
# the joint is held, the less its end moves.

# %%
print(f"\n{'effects':26}{'unknowns':>9}{'steps':>7}{'time [ms]':>11}{'end [mm]':>10}{'friction loss [J]':>19}")
for name, unknowns, steps, milliseconds, amplitude, loss in rows:
    print(f"{name:26}{unknowns:9}{steps:7}{milliseconds:11.1f}{amplitude:10.4f}{loss:19.2e}")
nearly = solve(replace(everything, laws=replace(everything.laws, friction=1e-7)))
np.testing.assert_allclose(nearly.output("end"), free.output("end"), rtol=1e-4)
end = {name: amplitude for name, _, _, _, amplitude, _ in rows}
assert end["bonded"] < end["separation, stuck"] < end["separation and friction"] < end["separation, no friction"]
assert both.merit["friction_dissipation"] > 0 and abs(both.merit["energy_error"]) < 1e-2
assert abs(free.merit["friction_dissipation"]) < 1e-12

# %% [markdown]
# ## Harmonics: those that an accuracy needs
# Say that the joint turns with a rotor and is shaken three times a turn. In harmonics of the turn most contact forces
# are nil; `solve_to_accuracy` sees that while it raises the order, and leaves them out. Is that as accurate as every
# harmonic up to the same order? The truth is the motion in its own period, a third of a turn, with 32 harmonics: with
# 96 in those of the turn.

# %%
turning = replace(everything, frequency=everything.frequency / 3, load={0: model.load[0], 3: model.load[1]})
true = solve(replace(everything, harmonics=32))


def measure_error(solution):
    """Error of the end's motion over a turn, relative, its mean left out."""
    spectrum, exact = np.zeros((2, 3 * 32 + 1), complex)
    spectrum[list(solution.orders)] = solution.output("end")
    exact[3 * np.array(true.orders)] = true.output("end")
    return np.linalg.norm(spectrum[1:] - exact[1:]) / np.linalg.norm(exact[1:])


def clock(problem):
    """A solution from cold, and the time that it takes alone [s]."""
    begin = time.perf_counter()
    return solve(problem), time.perf_counter() - begin


found = solve_to_accuracy(turning, 0.01)
chosen, top = found.solution, found.solution.orders[-1]
alone, alone_seconds = clock(replace(chosen.problem))
full, full_seconds = clock(replace(chosen.problem, harmonics=top))
print(f"\n{'harmonics of the turn':40}{'unknowns':>9}{'time [ms]':>11}{'true error [%]':>16}")
for orders, solution, seconds in (
    (f"every one up to {top}", full, full_seconds),
    (", ".join(map(str, chosen.orders)), alone, alone_seconds),
    ("the same, and all that chose them", chosen, found.seconds),
):
    print(f"{orders:40}{solution.unknowns:9}{1e3 * seconds:11.1f}{100 * measure_error(solution):16.3f}")
print(f"estimated error: {100 * found.estimate.total:.3f} %")
assert found.reached and measure_error(chosen) < 0.01
assert {3, 6, 9} <= set(chosen.orders) and not {2, 4, 5, 7, 8} & set(chosen.orders)
assert chosen.unknowns < 0.7 * full.unknowns
assert abs(measure_error(alone) - measure_error(full)) < 1e-3
