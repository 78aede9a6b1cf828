"""Wear through scenes: what a run writes of it, and what it tells where wear is more than a joint can take."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from scene_runs import read_table, run_scene
from small_scenes import write_blocks

from ewr_fenicsx import solve
from ewr_fenicsx.cli import main
from ewr_fenicsx.output.output import FIELDS, FIELDS_OF_WEAR
from ewr_fenicsx.wear import wear


def test_a_summary_says_why_wear_stopped(tmp_path, capsys, monkeypatch):
    evolve = wear.evolve_wear
    stop = lambda *given, **named: replace(evolve(*given, **named), stopped="after 2 cycles: enough")  # noqa: E731
    monkeypatch.setattr(wear, "evolve_wear", stop)
    facts = run_scene(tmp_path, write_blocks("[wear]\ncycles = 2\ncoefficient = 1e-12", shake=150.0))["wear"]
    assert facts["stopped"] == "after 2 cycles: enough" and facts["cycles"] == 2 and facts["solves"] >= 2
    assert facts["reservations_of_first_solve"] == []
    assert "estimated error of the response and the wear rate" in capsys.readouterr().out


def test_where_a_cycle_wears_too_much_the_remedy_is_a_key_of_the_scene(tmp_path, capsys):
    wears = "[wear]\ncycles = 20\ncoefficient = 5e-5\n"
    stopped = run_scene(tmp_path, write_blocks(wears, shake=150.0))["wear"]["stopped"]
    assert stopped.startswith("after 0 cycles: one cycle wears more than contact can follow")
    assert stopped.endswith("; lower wear.coefficient, or let wear pass as a flow: wear.tolerance = 0.01")
    assert f"stopped {stopped}" in capsys.readouterr().out
    healed = run_scene(tmp_path, write_blocks(f"{wears}tolerance = 0.01\n", shake=150.0), "healed")["wear"]
    assert healed["stopped"] is None and healed["cycles"] == 20
    assert 0 < healed["rough_cycles"] <= 20, "a twentieth of a cycle is all that contact can follow at first"
    assert f"NOT within the tolerance: each of {healed['rough_cycles']} cycles wore" in capsys.readouterr().out


def test_wear_tells_of_the_fallbacks_of_its_first_solve(tmp_path, capsys, monkeypatch):
    """The worn joint is found from there without any."""
    late = lambda *given, **named: replace(solve(*given, **named), fallbacks=("one: no", "two: yes"))  # noqa: E731
    monkeypatch.setattr("ewr_fenicsx.wear.cycle_jumps.solve", late)
    run_scene(tmp_path, write_blocks("[wear]\ncycles = 2\ncoefficient = 1e-12"))
    out = capsys.readouterr().out
    assert "the first solve: fallback: one: no" in out and "the first solve: fallback: two: yes" in out
    assert "the first solve: found by a fallback: there may be other solutions" in " ".join(out.split())


def test_wear_writes_its_history_and_the_worn_joint(tmp_path, capsys):
    wears = "[wear]\ncycles = 20\ncoefficient = 1e-9"
    summary = run_scene(tmp_path, write_blocks(wears, "[contact]\nfriction = 0.1", shake=150.0))
    assert "20 cycles in" in capsys.readouterr().out
    history = read_table(tmp_path / "results" / "wear.csv")
    worn = [row["worn_depth [m]"] for row in read_table(tmp_path / "results" / "pairs.csv")]
    assert history[-1]["cycles"] == 20 and history[0]["deepest [m]"] == 0
    assert max(worn) == pytest.approx(history[-1]["deepest [m]"], rel=1e-12)
    assert max(worn) > 0
    assert {"wear.csv", "wear.png", "worn_depth.xdmf", "worn_gap.xdmf", "worn_surface.xdmf"} <= set(summary["files"])
    fields = {Path(name).stem for name in summary["files"] if name.endswith(".xdmf")}
    assert fields == {*FIELDS, *FIELDS_OF_WEAR, "gap", "slip"}, "names that laws of one's own may not have"
    capsys.readouterr()
    assert main(["info", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "results")]) == 0
    told = capsys.readouterr()
    shown = next(line for line in told.out.splitlines() if line.startswith("wear "))
    assert " on " in shown and "20 cycles" in shown and shown.rstrip().endswith("%"), "its share of the run's time"
    assert "no run of this scene" not in told.err
    assert main(["info", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "elsewhere")]) == 0
    assert "elsewhere holds no run of this scene as it is" in capsys.readouterr().err


def test_wear_through_a_body_is_no_result(tmp_path, capsys):
    wears = "[wear]\ncycles = 200\ncoefficient = 1e-3\ntolerance = 0.1"
    summary = run_scene(tmp_path, write_blocks(wears, "[contact]\nfriction = 0.1", shake=150.0))
    told = capsys.readouterr()
    assert "wear.coefficient = 0.001 1/Pa is far above that of any joint" in told.err
    assert "m deep, more than 0.03 m" in told.out
    assert "NOT a result: a body is only 0.03 m thick; see wear.coefficient" in told.out
    assert "more than 0.03 m" in summary["wear"]["stopped"] and summary["wear"]["cycles"] < 200
