# %% [markdown]
# # The blade root, from geometry to ParaView
#
# A compressor blade hangs in its disk by a fir-tree root. A steady pull presses four flanks of the root against the
# disk; a force at the tip shakes the blade just below the joint's first resonance. How much do the flanks slip, do
# they open, and what does the tip do?
#
# The equation of motion of the reduced structure is
#
# $$ M \ddot x + D \dot x + K x = B^T \lambda + f(t), \qquad q = B x $$
#
# with the gap and slip of 40 pairs of nodes in $q$ and their contact forces in $\lambda$. Signorini's and Coulomb's
# laws tie $\lambda$ to $q$; the method seeks the periodic solution in Fourier space. The steps below are those of
# `ewr run`.

# %%
from pathlib import Path

import numpy as np

from ewr_fenicsx import load_scene, solve
from ewr_fenicsx.output.output import list_files, write_results
from ewr_fenicsx.solution.contact_state import OPEN, SLIP, classify_contact
from ewr_fenicsx.structure.chain import build_chain, pose_problem

HERE = Path(__file__).parent

# %% [markdown]
# ## Scene and structure
# The scene names a geometry builder, the loads and the contact laws. From it come the mesh, the finite-element
# matrices, the pairs of the joint, and a Craig-Bampton model that keeps every contact degree of freedom.

# %%
scene = load_scene(HERE / "blade_root.toml")
chain = build_chain(scene)
model, interface = chain.reduction.model, chain.interface
first = chain.reduction.full_stick.frequency[0]
print(f"{model.pairs} pairs, {model.size} reduced coordinates; first full-stick mode at {first:.1f} Hz")
assert model.pairs == 40
assert abs(first / 1090 - 1) < 0.01

# %% [markdown]
# ## The periodic solution
# The blade itself is free: only contact holds it against the pull. So the static part of the problem decides on its
# three rigid-body motions too.

# %%
solution = solve(pose_problem(scene, model, interface), tolerance=scene.solver.tolerance)
print(solution.summary())
tip = solution.output("tip")
print(f"tip amplitude {1e3 * abs(tip[1]):.3f} mm")

# %% [markdown]
# ## Is it right?
# On average over the period the contact forces must carry the pull, to the last digit that the solve left over. The
# work of the shaker must leave through viscous damping and friction.

# %%
pull = np.array(scene.loads["axial_pull"].force)
normal, friction = (solution.history(name, 256).mean(axis=0) for name in ("normal_force", "friction_force"))
on_blade = friction @ interface.tangent - normal @ interface.normal
imbalance = np.linalg.norm(on_blade + pull) / np.linalg.norm(pull)
print(f"mean contact force on the blade {on_blade} N, imbalance {imbalance:.1e}")
assert imbalance < 1e-8
print(f"energy error {solution.merit['energy_error']:.1e} of the work a cycle")
assert abs(solution.merit["energy_error"]) < 0.05

# %% [markdown]
# ## What the joint does
# Sliding of 1 to 50 micrometres a cycle is what wears a joint by fretting. No body leaves its seat: at every instant
# some pairs of each side carry load.

# %%
sliding = solution.sliding_speed().mean(axis=0) / solution.problem.frequency
state = classify_contact(solution, 1024)
print(f"sliding {1e6 * sliding.min():.1f} to {1e6 * sliding.max():.1f} micrometres a cycle")
print(f"open {(state == OPEN).mean():.0%} and slipping {(state == SLIP).mean():.0%} of the time, mean over pairs")
assert 1e-6 < sliding.max() < 50e-6
assert (state != OPEN).any(axis=1).all()

# %% [markdown]
# ## Results
# Open `displacement.xdmf` in ParaView, apply *Warp By Vector*, and press play.

# %%
folder = HERE / "results" / "blade_root"
print()
print(list_files(write_results(folder, chain, solution, overwrite=True)))
