# %% [markdown]
# # Does the truncated solution stay on the contact sets?
#
# Signorini's law allows a pair two states: closed under pressure, or open without any. Coulomb's allows two as well:
# stuck below the friction limit, or slipping at it. In the (gap, force) and (slip velocity, friction) planes these are
# broken lines. A harmonic-balance solution meets the laws only on average, weighted with its harmonics, so its points
# scatter around the lines. By how much?
#
# This is the study of the paper's Figure 4: $\mu = 0.2$, harmonics up to 15, 1024 samples a period, quasi-static and at
# 500 Hz. Our fir tree needs a strong shaker to slip and open this far from its resonance (`contact_sets.toml`).

# %%
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from study import AGREES, DIFFERS, OPEN, RESULTS, judge, report, timed

from ewr_fenicsx import load_scene, solve
from ewr_fenicsx.structure.chain import build_chain, pose_problem

SCENE = Path(__file__).with_suffix(".toml")
QUASI_STATIC, DYNAMIC = 10.0, 500.0  # Hz; the first mode lies near 1090 Hz, and (10 / 1090)^2 = 8e-5
SAMPLES, MU = 1024, 0.2
FLANK = "top_left"

# %% [markdown]
# ## Distance from the sets
# Lengths in the two planes need units: the largest force and the largest gap for Signorini; the friction limit
# $\mu \lambda_N$ of the same instant and the largest slip velocity for Coulomb. Instants at which a pair carries less
# than a twentieth of the largest normal force are left out of the latter: at lift-off the quotient means nothing.


# %%
def measure_distances(solution) -> dict[str, float]:
    """Largest and root-mean-square distance of all pairs at all samples from both sets, in their units."""
    gap, normal = (solution.history(name, SAMPLES) for name in ("gap", "normal_force"))
    velocity, friction = (solution.history(name, SAMPLES) for name in ("slip_velocity", "friction_force"))
    g, n = gap / max(gap.max(), 1e-12), normal / normal.max()
    signorini = np.where((g >= 0) & (n >= 0), np.minimum(g, n), np.hypot(np.minimum(g, 0), np.minimum(n, 0)))
    loaded = normal > 0.05 * normal.max()
    v = velocity[loaded] / np.abs(velocity).max()
    share = friction[loaded] / (MU * normal[loaded])
    at_limit = np.abs(share + np.sign(v))  # on one of the slipping branches: friction opposes slip
    stuck = np.hypot(v, np.maximum(0, np.abs(share) - 1))
    coulomb = np.minimum(at_limit, stuck)
    rms = lambda x: float(np.sqrt(np.mean(x**2)))  # noqa: E731
    return {
        "signorini_max": float(signorini.max()),
        "signorini_rms": rms(signorini),
        "coulomb_max": float(coulomb.max()),
        "coulomb_rms": rms(coulomb),
    }


# %% [markdown]
# ## Both solutions, and what the pairs of each flank do
# The same at a third of the harmonics shows whether the distances are those of truncation: they must shrink with N.


# %%
def describe_flank(solution, pairs: np.ndarray, outward: np.ndarray) -> dict[str, list[float]]:
    """Figures of a flank's pairs, from the innermost to the outermost."""
    pairs = pairs[np.argsort(outward[pairs])]
    gap, normal = (solution.history(name, SAMPLES)[:, pairs] for name in ("gap", "normal_force"))
    speed = solution.sliding_speed(SAMPLES)[:, pairs]
    return {
        "largest_gap_um": 1e6 * gap.max(axis=0),
        "mean_normal_force_N": normal.mean(axis=0),
        "largest_slip_velocity_mm_s": 1e3 * speed.max(axis=0),
        "sliding_um": 1e6 * speed.mean(axis=0) / solution.problem.frequency,
    }


def main(folder: Path = RESULTS / "contact_sets") -> dict:
    figures: dict = {}
    with timed(figures):
        chain = build_chain(load_scene(SCENE))
        model, interface = chain.reduction.model, chain.interface
        solutions = {}
        for name, frequency in (("quasi_static", QUASI_STATIC), ("dynamic", DYNAMIC)):
            problem = replace(pose_problem(chain.scene, model), frequency=frequency)
            solutions[name] = solve(problem)
            coarse = solve(replace(problem, harmonics=5))
            for order, solution in ((15, solutions[name]), (5, coarse)):
                figures[f"{name}, N = {order}"] = measure_distances(solution)
        outward = np.abs(interface.position[:, 0])
        flanks = {flank: np.flatnonzero(interface.flank_of_pair == k) for k, flank in enumerate(interface.flanks)}
        for name, solution in solutions.items():
            for flank, pairs in flanks.items():
                figures[f"{name}, {flank}"] = {
                    key: np.round(values, 4).tolist()
                    for key, values in describe_flank(solution, pairs, outward).items()
                }
    verdicts = compare(figures)
    report("contact_sets", figures, verdicts, lambda path: draw(path, solutions, flanks[FLANK], outward), folder)
    check(figures, verdicts)
    return figures


# %% [markdown]
# ## What the paper says, and what we see


# %%
def compare(figures: dict) -> list:
    fine, coarse = figures["dynamic, N = 15"], figures["dynamic, N = 5"]
    top, bottom = figures["dynamic, top_left"], figures["dynamic, bottom_left"]
    gap, force, sliding = (np.array(top[key]) for key in ("largest_gap_um", "mean_normal_force_N", "sliding_um"))
    velocity = np.array(top["largest_slip_velocity_mm_s"])
    opens_outside = gap[-1] > gap[0]
    rises = force[: len(force) // 2].mean() > force[len(force) // 2 :].mean() and velocity[0] > velocity[-1]
    return [
        judge(
            "Overall, the method demonstrates strong agreement with the true contact sets.",
            None,  # the paper gives no measure
            f"The paper gives no measure. At 500 Hz, N = 15, ours lies at most {fine['signorini_max']:.3f} from "
            f"Signorini's set and {fine['coulomb_max']:.2f} from Coulomb's (rms {fine['coulomb_rms']:.3f}), in the "
            "units of the text.",
        ),
        judge(
            "Minute differences are attributed to the Gibbs phenomenon.",
            fine["signorini_rms"] < coarse["signorini_rms"] and fine["coulomb_rms"] < coarse["coulomb_rms"],
            f"From N = 5 to 15 the rms distances fall from {coarse['signorini_rms']:.4f} to "
            f"{fine['signorini_rms']:.4f} "
            f"(Signorini) and from {coarse['coulomb_rms']:.3f} to {fine['coulomb_rms']:.3f} (Coulomb): they are "
            f"those of "
            "truncation.",
        ),
        judge(
            "These results are broadly representative of all individual surfaces.",
            0.5 < np.max(bottom["sliding_um"]) / np.max(sliding) < 2,
            f"Left and right are each other's mirror image. But at 500 Hz the top flanks slide up to "
            f"{sliding.max():.0f} micrometres a cycle and open by {gap.max():.1f}, the bottom ones "
            f"{np.max(bottom['sliding_um']):.0f} "
            f"and {np.max(bottom['largest_gap_um']):.1f}.",
        ),
        judge(
            "The root interface exhibits greater separation near its outer edge.",
            bool(opens_outside),
            f"Top left flank, 500 Hz: the innermost pair opens {gap[0]:.2f} micrometres, the outermost {gap[-1]:.2f}.",
        ),
        judge(
            "Toward the central, innermost region, contact pressures and slip velocities increase.",
            bool(rises),
            f"From the innermost to the outermost pair the mean normal force goes {force[0]:.0f}, "
            f"{force[len(force) // 2]:.0f} (middle), {force[-1]:.0f} N (end pairs have half the area of the others) "
            f"and the "
            f"largest slip velocity {velocity[0]:.0f}, {velocity[len(force) // 2]:.0f}, {velocity[-1]:.0f} mm/s.",
        ),
        judge(
            "Slip remains largely uniform.",
            np.ptp(sliding) < 0.2 * sliding.mean(),
            f"Sliding along the top left flank: {sliding.min():.1f} to {sliding.max():.1f} micrometres a cycle.",
        ),
    ]


# %% [markdown]
# ## Picture


# %%
def draw(path: Path, solutions: dict, pairs: np.ndarray, outward: np.ndarray) -> None:
    figure = Figure(figsize=(9, 7), layout="constrained")
    grid = figure.subplots(2, 2)
    place = (outward[pairs] - outward[pairs].min()) / np.ptp(outward[pairs])
    for row, (name, solution) in zip(grid, solutions.items(), strict=True):
        gap, normal = (
            1e6 * solution.history("gap", SAMPLES)[:, pairs],
            solution.history("normal_force", SAMPLES)[:, pairs],
        )
        velocity = 1e3 * solution.history("slip_velocity", SAMPLES)[:, pairs]
        share = solution.history("friction_force", SAMPLES)[:, pairs] / (MU * np.maximum(normal, 1e-9))
        loaded = normal > 0.05 * normal.max()
        widest, fastest = max(1.1 * gap.max(), 1e-3), 1.1 * np.abs(velocity).max()
        row[0].plot(
            [0, 0, widest], [1.1 * normal.max(), 0, 0], color="#c1121f", alpha=0.3, linewidth=4, label="exact set"
        )
        row[1].plot([-fastest, 0, 0, fastest], [1, 1, -1, -1], color="#c1121f", alpha=0.3, linewidth=4)
        colours = np.broadcast_to(place, normal.shape)
        order = {"cmap": "viridis", "s": 3, "vmin": 0, "vmax": 1, "rasterized": True}
        row[0].scatter(gap, normal, c=colours, **order)
        shown = row[1].scatter(velocity[loaded], share[loaded], c=colours[loaded], **order)
        row[0].set(xlabel="gap [µm]", ylabel="normal force [N]")
        row[1].set(xlabel="slip velocity [mm/s]", ylabel="friction force / (µ normal force)", ylim=(-1.6, 1.6))
        for axes, law in zip(row, ("Signorini", "Coulomb"), strict=True):
            axes.set_title(f"{law}: {name.replace('_', '-')}, {solution.problem.frequency:g} Hz")
    grid[0, 0].legend(loc="upper right")
    bar = figure.colorbar(shown, ax=grid, shrink=0.6, aspect=30)
    bar.set_ticks([0, 1], labels=["innermost pair", "outermost"])
    figure.suptitle("Top left flank, harmonics 0 to 15: all pairs at 1024 instants on the contact sets")
    figure.savefig(path, dpi=100)


# %% [markdown]
# ## Numbers that must not change
# Distances from the sets must shrink with N, quasi-statically and at 500 Hz; mirrored flanks must slide alike.


# %%
def check(figures: dict, verdicts: list) -> None:
    for name in ("quasi_static", "dynamic"):
        fine, coarse = figures[f"{name}, N = 15"], figures[f"{name}, N = 5"]
        assert fine["signorini_max"] < 0.05
        assert fine["coulomb_rms"] < 0.1
        assert fine["signorini_rms"] < 0.5 * coarse["signorini_rms"]
        assert fine["coulomb_rms"] < 0.7 * coarse["coulomb_rms"]
    for flank in ("top", "bottom"):
        left, right = figures[f"dynamic, {flank}_left"], figures[f"dynamic, {flank}_right"]
        np.testing.assert_allclose(left["sliding_um"], right["sliding_um"], rtol=1e-3)
    found = [v.verdict for v in verdicts]
    assert found == [OPEN, AGREES, DIFFERS, DIFFERS, DIFFERS, AGREES]


# %%
if __name__ == "__main__":
    main()
