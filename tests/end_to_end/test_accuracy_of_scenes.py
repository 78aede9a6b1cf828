"""A scene that asks for an accuracy, and what the knobs of a scene cost: through files and the command line."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scene_runs import read_table
from small_scenes import read_demo, write_blocks

from ewr_fenicsx import solve, solve_to_accuracy
from ewr_fenicsx.accuracy import estimates
from ewr_fenicsx.cli import main, print_costs
from ewr_fenicsx.errors import ModelError, SceneError
from ewr_fenicsx.runs import cost_report
from ewr_fenicsx.runs.study import _Modes, run_study
from ewr_fenicsx.scene.scene import Excitation, load_scene
from ewr_fenicsx.structure.chain import Stopwatch, build_chain, pose_problem


def write_scene(folder: Path, *more: str) -> Path:
    """The demo with two blocks, and more entries."""
    text = read_demo("two_blocks").split("[solver]")[0]
    path = folder / "scene.toml"
    path.write_text(text + "\n" + "\n".join(more) + "\n", encoding="utf-8")
    return path


def write_root(path: Path, frequency: object, *more: str) -> Path:
    """A blade root with a coarse mesh, at a frequency or several, and more entries."""
    text = read_demo("blade_root")
    text = text.replace("[loads.axial_pull]", "parameters = {mesh_size = 0.003, pairs = 4}\n[loads.axial_pull]", 1)
    text = text.replace("frequency = 1000.0", f"frequency = {frequency}")
    path.write_text("\n".join([text, *more]) + "\n", encoding="utf-8")
    return path


def test_an_accuracy_is_reached_and_told(tmp_path, capsys):
    scene = write_scene(tmp_path, "[solver]", "accuracy = 0.1")
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert "of 0.1 asked (harmonics" in told
    assert "modes" in told, "the chain knows which coordinates are modes"
    assert "NOT as accurate" not in told
    facts = json.loads((tmp_path / "out" / "summary.json").read_text())["accuracy"]
    assert facts["asked"] == 0.1 and facts["reached"] is True and facts["limit"] == ""
    assert 0 < facts["estimate"]["total"] <= 0.1 and facts["estimate"]["modes"] > 0


@pytest.mark.parametrize(
    "error, told", [(MemoryError(), "out of memory"), (ModelError("1.5 Hz hits a mode"), "1.5 Hz hits a mode")]
)
def test_an_estimate_that_fails_loses_no_result(tmp_path, capsys, monkeypatch, error, told):
    def fail(*_):
        raise error

    monkeypatch.setattr(estimates, "estimate_at_once", fail)
    assert main(["run", str(write_scene(tmp_path)), "--out", str(tmp_path / "out")]) == 0
    assert f"its error is not known: {told}" in capsys.readouterr().out
    facts = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert facts["estimate"] is None and facts["solution"]["converged"]


@pytest.mark.parametrize("modes", [1, 3, 10])
def test_modes_that_take_no_part_in_the_motion_tell_nothing_of_those_left_out(modes):
    """A rod driven below the first mode along its axis: those kept bend, and harmonics are raised first, in vain."""
    scene = load_scene(Path(__file__).parents[2] / "demos" / "tapping_rod.toml")
    tips = {}
    for count in (modes, 60):
        reduction = scene.reduction.model_copy(update={"modes": count})
        chain = build_chain(scene.model_copy(update={"reduction": reduction}))
        problem, watched = pose_problem(chain.scene, chain.reduction.model), _Modes(chain, Stopwatch())
        tips[count] = solve_to_accuracy(problem, 0.01, **watched.choice)
    found, truth = (tip.solution.output("tip")[1] for tip in tips.values())
    assert abs(found - truth) < 2 * max(0.01, tips[modes].estimate.total) * abs(truth)
    assert abs(found - truth) < 0.03 * abs(truth) and tips[modes].levels[-1].modes > modes
    assert tips[modes].estimate.modes < 0.03


def test_modes_are_raised_to_all_that_a_mesh_has_but_one(tmp_path, capsys):
    """Shaken above most modes of a coarse mesh, of which no more can be had beside those known."""
    text = read_demo("two_blocks").replace(
        'two_blocks.py"', 'two_blocks.py"\nparameters = { pairs = 4, mesh_size = 20e-3 }'
    )
    text = text.replace("frequency = 1000.0", "frequency = 60000.0").replace("250.0", "20.0").split("[solver]")[0]
    (tmp_path / "scene.toml").write_text(text + "[solver]\naccuracy = 1e-3\n", encoding="utf-8")
    assert main(["run", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "out")]) == 0
    most = build_chain(load_scene(tmp_path / "scene.toml")).reduction.most_modes
    assert f"modes raised from 30 to {most - 1}" in capsys.readouterr().out


def test_what_is_not_truncated_has_no_estimate(tmp_path, capsys):
    """Nothing oscillates: a static solve."""
    text = write_scene(tmp_path).read_text().split("[excitation]")[0]
    (tmp_path / "scene.toml").write_text(text.split("[loads.shake]")[0] + "[outputs" + text.split("[outputs")[1])
    assert main(["run", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "out")]) == 0
    assert "estimated error" not in capsys.readouterr().out
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["estimate"] is None


def test_an_output_that_symmetry_keeps_at_rest_does_not_count(tmp_path):
    """What cancels there leaves rounding; compared with itself it asked for ever more harmonics."""
    across = '[outputs.across]\nboundary = "tip"\ndirection = [0.0, 1.0]\n[contact]\nfriction = 0.3'
    scene, estimates = tmp_path / "scene.toml", []
    for more in ("", across):
        mesh = "disk_rows = 8, columns = 8"
        scene.write_text(write_blocks(more, parameters=mesh, shake=100.0, frequency=900.0), encoding="utf-8")
        chain = build_chain(load_scene(scene))
        found = solve_to_accuracy(pose_problem(chain.scene, chain.reduction.model, chain.interface), 0.05)
        assert found.reached and len(found.levels) == 1
        estimates.append(found.estimate.total)
    moved = [np.linalg.norm(found.solution.output(name)[1:]) for name in ("tip", "across")]
    assert 0 < moved[1] < 1e-9 * moved[0]
    assert 0 < estimates[1] < 1.1 * estimates[0] < 1e-3


@pytest.mark.parametrize(
    ("allowed", "asked", "told"),
    [
        ({"highest": 5}, 1e-4, "harmonic 5 is the highest allowed; ask for less, or give solver.harmonics in place of"),
        ({"most_modes": 1}, 0.03, "modes of the reduced model leave an error of"),
    ],
)
def test_what_keeps_a_scene_from_its_accuracy_is_told_in_words_of_a_scene(
    tmp_path, capsys, monkeypatch, allowed, asked, told
):
    limited = lambda *given, **named: solve_to_accuracy(*given, **named | allowed)  # noqa: E731
    monkeypatch.setattr("ewr_fenicsx.accuracy.accuracy.solve_to_accuracy", limited)
    path = write_root(tmp_path / "scene.toml", 1050.0, "[reduction]", "modes = 1", "[solver]", f"accuracy = {asked}")
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "NOT as accurate as asked: " in said and told in said and "allow more" not in said
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert told in summary["accuracy"]["limit"] and "ask for less, or" in summary["accuracy"]["limit"]
    assert ("raise reduction.modes above 1" in said) == ("most_modes" in allowed)


def test_modes_are_raised_where_a_scene_has_too_few(tmp_path, capsys):
    """A blade root with one mode: the answer is that of a hundred modes and more harmonics, within the accuracy."""
    path = write_root(tmp_path / "scene.toml", 1050.0, "[reduction]", "modes = 1", "[solver]", "accuracy = 0.05")
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr()
    assert "modes raised from 1 to" in told.out and "NOT as accurate" not in told.out
    assert "more modes" in told.err, "a stage of its own"
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert summary["seconds"]["more modes"] > 0
    modes = summary["model"]["fixed_interface_frequencies_Hz"]
    assert len(modes) > 1, "what is written is of the model that was solved"

    scene = load_scene(path)
    found = {}
    for count in (1, 100):
        chain = build_chain(scene.model_copy(update={"reduction": scene.reduction.model_copy(update={"modes": count})}))
        problem = pose_problem(scene, chain.reduction.model, chain.interface)
        found[count] = solve(replace(problem, harmonics=21)).output("tip")[1:]
    tip = {entry["harmonic"]: entry["real"] + 1j * entry["imag"] for entry in summary["solution"]["outputs"]["tip"]}
    answer = np.array([tip.get(h, 0.0) for h in range(1, 22)])
    off = lambda here: np.linalg.norm(here - found[100]) / np.linalg.norm(found[100])  # noqa: E731
    assert off(answer) <= 0.05
    assert off(found[1]) > 0.05, "one mode was too few"


def test_modes_that_led_nowhere_may_be_asked_for_again(tmp_path):
    """As wear does, which stays on the model that has a solution."""
    modes = _Modes(build_chain(load_scene(write_scene(tmp_path, "[reduction]", "modes = 2"))), Stopwatch())
    first, coordinates = modes.keep_more(4)
    again, same = modes.keep_more(4)
    assert again.model is first.model and len(coordinates) == 4 and coordinates == same
    assert len(modes.keep_more(8)[1]) == 8


def test_a_sweep_is_as_accurate_as_asked(tmp_path, capsys):
    """With one mode to begin with; against single solves with harmonics and modes that are more than enough."""
    frequencies = [950.0, 1050.0, 1150.0]
    path = write_root(tmp_path / "scene.toml", frequencies, "[solver]", "accuracy = 0.1", "[reduction]", "modes = 1")
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert "of 0.1 asked, highest harmonics" in told and "NOT as accurate" not in told
    rows = read_table(tmp_path / "out" / "frequency_response.csv")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert len(summary["model"]["fixed_interface_frequencies_Hz"]) > 1
    assert {"sweep", "more modes"} <= set(summary["seconds"])
    assert len({row["highest_harmonic"] for row in rows}) > 1, "harmonics are chosen at each frequency"
    scene = load_scene(path)
    chain = build_chain(scene.model_copy(update={"reduction": scene.reduction.model_copy(update={"modes": 60})}))
    for frequency, row in zip(frequencies, rows, strict=True):
        assert row["frequency [Hz]"] == frequency
        assert row["estimate"] <= 0.1
        problem = pose_problem(scene, chain.reduction.model, chain.interface)
        true = np.abs(solve(replace(problem, frequency=frequency, harmonics=13)).output("tip")[1:])
        off = [row.get(f"|tip| harmonic {h}", 0.0) - true[h - 1] for h in range(1, 14)]
        assert np.linalg.norm(off) <= 0.1 * np.linalg.norm(true)


def test_wear_is_as_accurate_as_asked(tmp_path):
    """From one mode; jumps by the same accuracy; against harmonics, modes and jumps that are more than enough."""
    wear = ["[wear]", "coefficient = 1e-11", "cycles = 60"]
    asked = load_scene(
        write_root(tmp_path / "scene.toml", 1050.0, *wear, "[solver]", "accuracy = 0.1", "[reduction]", "modes = 1")
    )
    true = load_scene(
        write_root(tmp_path / "true.toml", 1050.0, *wear, "tolerance = 0.01", "[solver]", "harmonics = 13")
    )
    found, truth = (run_study(build_chain(scene)) for scene in (asked, true))
    assert len(found.chain.reduction.fixed_interface_frequencies) > 1
    assert "of 0.1 asked, highest harmonics" in found.told and "NOT as accurate" not in found.told
    (cycles, depth), (_, expected) = found.curve, truth.curve
    assert len(cycles) < 40, "it jumped"
    assert depth[-1] == pytest.approx(expected[-1], rel=0.3)  # as tests/verification/test_wear.py: three accuracies
    assert found.solution.problem.wear.max() == pytest.approx(truth.solution.problem.wear.max(), rel=0.3)
    found.write(tmp_path)
    assert all(row["estimate"] <= 0.1 for row in read_table(tmp_path / "wear.csv"))


@pytest.mark.parametrize(
    ("option", "name"), [((), "harmonic balance, N = 15"), (("--time-stepping",), "time stepping, 200 steps a period")]
)
def test_costs_are_told_and_written(tmp_path, capsys, monkeypatch, option, name):
    monkeypatch.setattr(cost_report, "ORDERS", (1, 3, 5))
    monkeypatch.setattr(cost_report, "HIGHEST", 15)
    monkeypatch.setattr(cost_report, "STEPS", (100, 200))
    folder = tmp_path / "costs"
    folder.mkdir()
    (folder / "cost.json").write_text("of an earlier survey")
    assert main(["cost", str(write_scene(tmp_path)), "--out", str(folder), "--overwrite", *option]) == 0
    printed = capsys.readouterr()
    assert f"reference: {name}" in printed.out
    assert re.search(r"^at \d+ Hz$", printed.out, re.MULTILINE)
    assert "settings" in printed.err and "left" in printed.err
    found = json.loads((folder / "cost.json").read_text(encoding="utf-8"))
    errors = {r["value"]: r["errors"]["output"] for r in found["rows"] if r["knob"] == "N"}
    assert set(errors) == {1, 3, 5}
    assert errors[1] > errors[5] > found["own_error"]
    assert (folder / "cost.png").stat().st_size > 10_000
    stages = {"mesh", "JIT", "matrices", "interface", "reduction", "solve: compose", "solve: newton"}
    assert set(found["stages"]) == stages | {"stability", "write"}
    assert "stages of a run: mesh " in printed.out


@pytest.mark.parametrize(
    ("there", "option", "message"),
    [
        ("summary.json", (), r"result folder .*there exists and is kept; give --overwrite"),
        ("summary.json", ("--overwrite",), r"there holds 'summary\.json', which this command does not write"),
        ("cost.json", (), r"result folder .*there exists and is kept; give --overwrite"),
    ],
)
def test_costs_are_not_dropped_among_other_files(tmp_path, capsys, there, option, message):
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / there).write_text("{}")
    assert main(["cost", str(write_scene(tmp_path)), "--out", str(tmp_path / "there"), *option]) == 2
    assert re.search(message, capsys.readouterr().err)
    assert [path.name for path in (tmp_path / "there").iterdir()] == [there]


def test_the_costs_of_a_sweep_name_the_frequency_that_they_are_of(tmp_path, monkeypatch):
    monkeypatch.setattr(cost_report, "ORDERS", (1, 3))
    monkeypatch.setattr(cost_report, "HIGHEST", 7)
    scene = load_scene(write_scene(tmp_path))
    swept = scene.model_copy(update={"excitation": Excitation(frequency=(700.0, 800.0, 900.0))})
    report = cost_report.survey_scene(build_chain(swept))
    assert report.told.startswith("at 700 Hz, the first of the sweep's 3 frequencies\nreference: ")
    assert "stages of a run without its sweep: mesh " in report.told


def test_the_run_that_is_timed_is_solved_as_closely_as_the_scene_asks(tmp_path, monkeypatch):
    asked, solve = [], cost_report.solve
    monkeypatch.setattr(cost_report, "solve", lambda *given, **more: asked.append(more) or solve(*given, **more))
    scene = load_scene(write_scene(tmp_path))
    loose = scene.model_copy(update={"solver": scene.solver.model_copy(update={"tolerance": 1e-4})})
    assert "write" in cost_report.time_run(build_chain(loose))
    assert asked == [{"tolerance": 1e-4}]


def test_what_a_setting_is_said_to_reach_allows_for_the_error_of_the_reference(tmp_path, monkeypatch):
    """0.4 % off a reference that may itself be 0.7 % off is no 1 %."""
    row = {"knob": "N", "value": 3, "unknowns": 9, "steps": 5, "seconds": 0.1, "converged": True}
    monkeypatch.setattr(cost_report, "survey", lambda *_, **__: [row | {"errors": {"output": 0.004}}])
    told = []
    for own in (0.005, 0.007):
        monkeypatch.setattr(cost_report, "solve_reference", lambda *_, own=own: (None, own, "a reference", 31))
        told.append(cost_report.survey_scene(build_chain(load_scene(write_scene(tmp_path)))).told)
    assert "  10.0%: N = 3: 4.0e-03" in told[1]
    assert "   1.0%: N = 3: 4.0e-03" in told[0] and "   1.0%: the reference is not good enough" in told[1]


def test_a_reference_that_is_stepped_in_time_shows_how_far_it_is(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(cost_report, "STEPS", (64, 128))
    monkeypatch.setattr(cost_report, "ORDERS", (1, 3))
    monkeypatch.setattr(cost_report, "survey", lambda *_, **__: [])
    cost_report.survey_scene(build_chain(load_scene(write_scene(tmp_path))), against_time_stepping=True, progress=True)
    assert capsys.readouterr().err.count("time stepping, periods") == 2


def test_settings_without_a_solution_are_told_from_the_others(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(cost_report, "ORDERS", (1, 3))
    monkeypatch.setattr(cost_report, "HIGHEST", 7)
    survey = cost_report.survey

    def fail_at_one(*given, **more):
        return [row | {"converged": row["value"] != 1} for row in survey(*given, **more)]

    monkeypatch.setattr(cost_report, "survey", fail_at_one)
    assert main(["cost", str(write_scene(tmp_path)), "--out", str(tmp_path / "costs")]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if re.match(r"N +\d", line)]
    assert "not found" in lines[0] and "e-" not in lines[0]
    assert "not found" not in lines[1] and "e-" in lines[1]


def test_a_narrow_terminal_cuts_no_costs(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    figures = ("output", "rms", "J_T", "largest normal force", "normal forces", "deepest wear", "wear", "signorini")
    row = {"knob": "N, rho_T by mobility, 8 N samples", "value": 12.0, "unknowns": 453, "steps": 27, "seconds": 1.234}
    row |= {"converged": True, "errors": {name: 1.2e-3 * k for k, name in enumerate(figures, 1)}}
    print_costs(cost_report.CostReport("", [row], "", 0.0, "", {}))
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("N, rho_T"))
    errors = [f"{error:.1e}" for error in row["errors"].values()]
    assert line.split() == [*row["knob"].split(), "12", "453", "27", "1.234", *errors]


def test_nothing_to_choose_where_nothing_oscillates(tmp_path):
    scene = load_scene(write_scene(tmp_path))
    still = {name: load for name, load in scene.loads.items() if load.harmonic == 0}
    with pytest.raises(SceneError, match="no load oscillates"):
        cost_report.survey_scene(build_chain(scene.model_copy(update={"loads": still})))
