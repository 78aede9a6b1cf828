# %% [markdown]
# # What does wear do to the response?
#
# Wear opens the joint where it presses hardest, so that sliding and the tip's response change as the flanks wear. How,
# for which friction, and at which frequency?
#
# This is the study of the paper's Figure 9: sliding indicator $J_T$ and tip displacement over 3000 cycles of wear, for
# $\mu$ = 0.2 to 1 near resonance, and from 500 to 1500 Hz for $\mu = 0.2$. The paper's 1000 Hz lies on the flank of our
# resonance where the joint sticks unless $\mu$ is low; so the first part is done at 1000 Hz and at 1075 Hz, where it
# slides with any of these.

# %%
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from study import AGREES, RESULTS, judge, report, timed

from ewr_fenicsx import Tolerance, evolve_wear, frequency_response, load_scene
from ewr_fenicsx.structure.chain import build_chain, pose_problem

SCENE = Path(__file__).with_name("blade_root.toml")
COEFFICIENT, CYCLES = 1e-11, 3000  # 1/Pa
FRICTION = (0.2, 0.4, 0.6, 0.8, 1.0)
NEAR_RESONANCE = (1000.0, 1075.0)  # Hz
FREQUENCIES = (500.0, 900.0, 950.0, 1000.0, 1050.0, 1100.0, 1250.0, 1500.0)  # Hz
SWEEP = np.arange(900.0, 1101.0, 12.5)  # Hz, for the resonance before and after
HALF_PERCENT = Tolerance(share=0.005)


# %%
def main(
    folder: Path = RESULTS / "wear_and_response",
    cycles: int = CYCLES,
    friction=FRICTION,
    frequencies=FREQUENCIES,
    sweep=SWEEP,
) -> dict:
    figures: dict = {}
    with timed(figures):
        chain = build_chain(load_scene(SCENE))
        problem = pose_problem(chain.scene, chain.reduction.model)

        def wear(frequency: float, mu: float):
            here = replace(problem, frequency=frequency, laws=replace(problem.laws, friction=mu))
            return evolve_wear(here, cycles, COEFFICIENT, HALF_PERCENT)

        by_friction = {(f, mu): wear(f, mu) for f in NEAR_RESONANCE for mu in friction}
        by_frequency = {f: by_friction.get((f, 0.2)) or wear(f, 0.2) for f in frequencies}
        histories = {f"{f:g} Hz, mu = {mu:g}": h for (f, mu), h in by_friction.items()}
        histories |= {f"{f:g} Hz, mu = 0.2": h for f, h in by_frequency.items()}
        for state, depth in (("unworn", None), ("worn", by_friction[1000.0, 0.2].depth[-1])):
            laws = replace(problem.laws, friction=0.2)
            curve = frequency_response(problem.model, laws, sweep, harmonics=5, progress=False, wear=depth)
            figures[f"peak, mu = 0.2, {state} [Hz]"] = float(curve.frequencies[curve.figure("rms_tip").argmax()])
        for name, history in histories.items():
            assert history.stopped is None, name
            figures[name] = {
                "J_T_um": np.round(1e6 * history.figure("J_T")[[0, -1]], 6).tolist(),  # changes are told from these
                "rms_tip_mm": np.round(1e3 * history.figure("rms_tip")[[0, -1]], 6).tolist(),
                "deepest_um": round(1e6 * float(history.depth[-1].max()), 4),
                "solves": history.solves,
            }
    verdicts = compare(figures, friction, frequencies)
    report("wear_and_response", figures, verdicts, lambda path: draw(path, by_friction, by_frequency), folder)
    check(figures, verdicts, cycles)
    return figures


# %% [markdown]
# ## What the paper says, and what we see


# %%
def compare(figures: dict, friction, frequencies) -> list:
    def change(what: str, frequency: float, mu: float) -> float:
        first, last = figures[f"{frequency:g} Hz, mu = {mu:g}"][what]
        return last / first - 1 if first > 1e-3 * abs(last) + 1e-6 else 0.0

    far = [f for f in frequencies if not 900 < f < 1200]
    slides = {f: [change("J_T_um", f, mu) for mu in friction] for f in NEAR_RESONANCE}
    tips = {f: [change("rms_tip_mm", f, mu) for mu in friction] for f in NEAR_RESONANCE}
    percents = lambda values: ", ".join(f"{v:+.0%}" for v in values)  # noqa: E731
    listed = ", ".join(f"{mu:g}" for mu in friction)
    both = lambda of: "; ".join(f"{f:g} Hz: {percents(of[f])}" for f in NEAR_RESONANCE) + f" (mu = {listed})"  # noqa: E731
    near = [f for f in frequencies if f not in far]
    loudest_near = max(abs(change("rms_tip_mm", f, 0.2)) for f in near)
    loudest_far = max(abs(change("rms_tip_mm", f, 0.2)) for f in far)
    first = lambda what, f: figures[f"{f:g} Hz, mu = 0.2"][what][0]  # noqa: E731
    at_first = ", ".join(f"{first('J_T_um', f):.3g} micrometres at {f:g} Hz" for f in frequencies)
    return [
        judge(
            "Near resonance sliding generally increases with wear, more so for higher friction.",
            all(v > 0 for v in slides[1075.0]) and slides[1075.0][-1] > slides[1075.0][0],
            f"Change of J_T: {both(slides)}. At 1000 Hz the joint with mu = 0.8 and more sticks throughout and does "
            f"not wear.",
        ),
        judge(
            "The lowest coefficient, mu = 0.2, exhibits a largely constant amount of sliding.",
            abs(slides[1000.0][0]) < 0.2,
            f"At 1000 Hz its J_T changes by {slides[1000.0][0]:+.0%}, at 1075 Hz by {slides[1075.0][0]:+.0%}: wear "
            f"moves the peak of the response from {figures['peak, mu = 0.2, unworn [Hz]']:g} to "
            f"{figures['peak, mu = 0.2, worn [Hz]']:g} Hz (worn at 1000 Hz), and with it the sliding.",
        ),
        judge(
            "Tip displacement falls with wear for lower friction.",
            tips[1000.0][0] < 0,
            f"Change of the tip's RMS: {both(tips)}. The peak moves down through 1000 Hz and away from 1075 Hz.",
        ),
        judge(
            "This reverses for the highest friction, mu = 1: the tip displacement grows.",
            tips[1075.0][-1] > 0,
            f"At 1075 Hz the tip's RMS changes by {tips[1075.0][-1]:+.0%} for mu = {friction[-1]:g}, at 1000 Hz by "
            f"{tips[1000.0][-1]:+.1%}.",
        ),
        judge(
            "Off resonance, sliding and tip displacement are smaller for all wear.",
            max(max(figures[f"{f:g} Hz, mu = 0.2"]["J_T_um"]) for f in far)
            < min(min(figures[f"{f:g} Hz, mu = 0.2"]["J_T_um"]) for f in (1000.0, 1050.0) if f in frequencies),
            f"J_T at first for mu = 0.2: {at_first}.",
        ),
        judge(
            "Tip displacement depends on wear more strongly near resonance than away from it.",
            loudest_near > loudest_far,
            f"Largest change of the tip's RMS over {CYCLES} cycles for mu = 0.2: {loudest_near:.0%} near resonance "
            f"({', '.join(f'{f:g}' for f in near)} Hz), {loudest_far:.2%} at {', '.join(f'{f:g}' for f in far)} Hz.",
        ),
    ]


# %% [markdown]
# ## Picture


# %%
def draw(path: Path, by_friction: dict, by_frequency: dict) -> None:
    figure = Figure(figsize=(9, 9.5), layout="constrained")
    grid = figure.subplots(3, 2, sharex=True)
    colours = ["#7b3fa0", "#1d6fb8", "#2a9d57", "#e08e0b", "#c1121f", "#222222", "#888888", "#b5651d"]
    rows = [(f"{f:g} Hz", {f"µ = {mu:g}": h for (at, mu), h in by_friction.items() if at == f}) for f in NEAR_RESONANCE]
    rows.append(("µ = 0.2", {f"{f:g} Hz": h for f, h in by_frequency.items()}))
    for line, (title, histories) in zip(grid, rows, strict=True):
        for colour, (label, history) in zip(colours, histories.items(), strict=False):
            line[0].plot(history.cycles, 1e6 * history.figure("J_T"), color=colour, label=label)
            line[1].plot(history.cycles, 1e3 * history.figure("rms_tip"), color=colour, label=label)
        line[0].set(ylabel="J_T [µm a cycle]", title=title, ylim=(0, None))
        line[1].set(ylabel="RMS of the tip [mm]", title=title, ylim=(0, None))
        line[1].legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    for axes in grid[-1]:
        axes.set_xlabel("cycles")
    figure.savefig(path, dpi=100)


# %% [markdown]
# ## Numbers that must not change
# Where nothing slides nothing wears, and nothing changes.


# %%
def check(figures: dict, verdicts: list, cycles: int) -> None:
    still = figures["500 Hz, mu = 0.2"]
    assert still["J_T_um"] == [0.0, 0.0]
    assert still["deepest_um"] < 1e-6
    assert still["rms_tip_mm"][0] == still["rms_tip_mm"][1]
    assert 1 < figures["1000 Hz, mu = 0.2"]["J_T_um"][0] < 50
    if cycles == CYCLES:
        assert figures["peak, mu = 0.2, worn [Hz]"] < figures["peak, mu = 0.2, unworn [Hz]"]
        assert [verdicts[i].verdict for i in (4, 5)] == [AGREES] * 2


# %%
if __name__ == "__main__":
    main()
