"""The words of docs/accuracy.md, around the tables that ``generate_accuracy.py`` fills in."""

from __future__ import annotations

PAGE_TEXT = """# What accuracy costs

Written by `docs/generate_accuracy.py` from `benchmarks/accuracy_cost.py` and `benchmarks/accuracy_honesty.py`: no
figure here was typed. `ewr cost SCENE` makes the same survey, shorter, for a scene of your own.

In short: ask for an accuracy; mind the mesh first ([which error dominates](#which-error-dominates)); to choose
settings yourself, see [what to choose](#what-to-choose). A *knob* is a setting that trades accuracy for time, such as
the highest harmonic N.

The case is `demos/blade_root.toml` at {frequency:g} Hz, near the resonance of the slipping joint. Errors are
relative. "Amplitude and phase" is the norm of the difference of the tip's harmonics over their norm; near a resonance
the phase makes most of it. Violations are the largest penetration or tension, and the largest excess over the
friction cone, each over the largest force or opening. Times are processor seconds on one core.

## Ask for an accuracy

    [solver]
    accuracy = 0.01          # in place of harmonics and samples

or `solve(problem, accuracy=0.01)`; `solve_to_accuracy` returns the way there as well.

**A single solution.** The solver starts with harmonics up to 3, or 5 where less than 2 % is asked, and estimates the
error by single Newton steps on neighbouring problems: with more harmonics and more samples, with another friction
weight, with fewer modes. It raises the knob that dominates, and starts the next solve at the last solution. Masses
that rub by themselves close the truncation of friction, and above harmonic 3 springs do where joints are elastic
(`docs/method.md`): both take fewer harmonics than dashpots. A second Newton step sharpens the estimate, unless the
first one tells of far more than is asked, or of far less where the last harmonics changed little. In large joints
operator splitting takes their place, as far as it gets. The estimate comes with the result, and so does the reason
where the accuracy was not reached. It covers the outputs at the given frequency, as far as contact solve and modes
decide on them. It knows nothing of the mesh's error. Sliding (`J_T`, and the work of friction) converges more slowly:
the same steps tell its own error, which is in no total, and is told beside it where it is much larger.

**Modes.** In a scene the modes are raised as well: `reduction.modes`, given or not, is where they begin. They are
doubled where those left out matter most; mesh, matrices, static responses and the modes already found are kept.

**Sweeps.** The curve is first followed with a few harmonics, which shows what solutions there are and how they hang
together. Then each point is solved again to the accuracy, from where it is and with about as many harmonics as its
neighbour took. `frequency_response.csv` has the columns `estimate` and `highest_harmonic`; frequencies at which the
accuracy was not reached are reported with the reason. With more harmonics a branch may turn back earlier: points of
the fold that it no longer reaches are left out, and so are points that ended on the other side of the fold, where the
sign of the Jacobian's determinant differs. A branch that does not show at all with few harmonics is not found.

**Wear.** The same is asked of the wear rate, by its largest error over its largest value: where most pairs stick,
outputs estimated to be right within 1 % may come with a worn depth that is off by more than 6 % (a case of
`tests/verification/test_wear.py`). Harmonics are chosen for the unworn joint and checked again at every step that is
kept; jumps have the same accuracy unless `wear.tolerance` gives their own. Where wear has all but died out, an error of
its rate counts over a tenth of the mean one, the depth worn so far by all cycles. Where nothing wears though pairs pass
each other while they are open, what the truncated force would wear of that is asked in its place: with few harmonics
pairs stick at once where they land, and the rest of that force tells that they may not. A test holds the worn depth to
twice the accuracy: one share for the jumps, one for the rates. `wear.csv` has the same two columns.

**From Python.** `frequency_response(..., accuracy=0.01)`, where `harmonics` are those of the first pass, and
`evolve_wear(..., accuracy=0.01)`. `more_modes` of `solve_to_accuracy` tells it how to get more modes, `figure` names
what is to be as accurate as the outputs; `evolve_wear` passes both on.

{asked}

The sample: two small joints, the blade root and the gallery's scenes, under loads from gentle to hard (in the names,
f1 is the first full-stick mode; the load is the ratio of oscillating to mean contact forces in full stick, `reached`
at that frequency, or `applied`: what a static load of that size would make); masses, blocks and rows of masses that
rub on a rigid wall (f1: 1000 rad/s, near their resonance); and masses that rub through springs stiffer than their own
(f1: 62 Hz). Linear cases (no pair ever slips or opens) are exact with any setting. The reference is time stepping, at
two step sizes and extrapolated, or a harmonic solve of high order where stepping has not settled ({ways}); where there
are both, cases in which they differ by more than a third of the smallest accuracy are left out. "Cheapest" is the
fastest fixed setting (harmonics, samples, masses or dashpots, springs) whose *true* error meets the accuracy, which a
user could not know. Reported as reached, but missed:

{misses}

Without a reference that can be trusted, and so not in the shares:

{without}

## What to choose

The cheapest setting tried whose error is within the limit, and stays there with more harmonics:

{choice}

![Error against time, the best settings](pictures/work_precision_best.png)

Numbers along the curves are N, or time steps a period; those in the legend, the power of time with which the error
falls. The grey band (Pareto front) joins the settings that no other one beats in both time and error, of
all that are on this page; the picture of the knobs below has the same band.

## Which error dominates

{dominance}

A knob is worth raising only while its error is among the largest of this table.

## Where N = 5 stands (the paper's choice)

{paper}

## The reference

{reference}

A harmonic solve shares no code with time stepping but the reduced model. Sliding and wear are less certain than the
response: they are integrals of the absolute velocity, which rings from step to step where a contact node has little
mass (`theta` above one half damps that; `tests/unit/test_cost.py` shows it). Forces are impulses over a step.

## Knob by knob

![Error against time, each knob](pictures/work_precision_knobs.png)

Highest harmonic, with the default weights and samples:

{orders}

The same with `rho_T` as the mobility at the first harmonics left out, as `solve_to_accuracy` sets it for dashpots:

{mobility}

And with 8 samples a harmonic:

{lean}

With springs for the harmonics left out ([method.md](method.md)):

{springs}

And with a residual of 1e-4 as enough, which errors of a per mille do not see:

{loose}

Odd harmonics only, with the mean and those that are loaded; the error that remains is that of the even ones left out:

{odd}

With the mean friction force set to zero, as in the paper:

{zero}

Samples a period at N = 9:

{samples}

Weights at N = 9:

{normal}

{tangential}

The solver's tolerance at N = 9:

{tolerance}

Time stepping from full stick until it is steady by its own measure, or for 120 periods. Here "unknowns" are steps a
period, and "steps" are periods:

{stepping}

{accelerated}

## Structure

At N = 5. Both degrees are compared with the finest mesh of degree 2, whose own error this table does not show. At a
fixed frequency near a resonance, most of a coarse mesh's error comes from the shift of the resonance.

{structure}

## Peak

{peak}

## Wear

Cycle jumps against solving every cycle:

{wear}

## Fewer harmonics

Harmonics with the smallest contact forces are left out, up to a share of the whole (`choose_harmonics`).
`solve_to_accuracy` does so between its solves, with a fiftieth of the accuracy as the share.

{adapted}

## Time by stage, and memory

`JIT` is the time in which dolfinx compiles the forms, or finds them compiled by an earlier run.

{stages}
"""
