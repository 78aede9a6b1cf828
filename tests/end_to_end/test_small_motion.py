"""Motions or wear too large for nodes that stay opposite each other, or for linear elasticity, are told."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from small_models import dovetail
from small_scenes import read_demo

from ewr_fenicsx import ContactLaws, ContactProblem, solve
from ewr_fenicsx.cli import main
from ewr_fenicsx.runs import findings
from ewr_fenicsx.runs.findings import measure_spacing
from ewr_fenicsx.structure.interface import Interface


def run_magnified(folder: Path, factor: float) -> list[str]:
    """The doubts about the two blocks with all loads, and so all motions, ``factor`` times as large."""
    text = read_demo("two_blocks")
    for force in ("[0.0, -1000.0]", "[250.0, 0.0]"):
        assert force in text
        text = text.replace(force, str([factor * f for f in json.loads(force)]))
    scene = folder / "blocks.toml"
    scene.write_text(text)
    assert main(["run", str(scene)]) == 0
    return json.loads((folder / "results" / "blocks" / "summary.json").read_text())["doubts_of_small_motion"]


def test_sliding_past_the_next_node_and_moving_by_a_thickness_are_told(tmp_path, capsys):
    """Loads magnify motions in proportion: the factors at which each is first said bracket what is measured."""
    (tmp_path / "below").mkdir()
    (tmp_path / "above").mkdir()
    doubts = run_magnified(tmp_path / "above", 1e5)
    assert any(doubt.startswith("top moves by up to") and "only 30 mm thick" in doubt for doubt in doubts)
    (slides,) = [doubt for doubt in doubts if "slide farther than their nodes are apart" in doubt]
    slid, apart = (float(words.split()[-1]) for words in slides.split(" mm")[:2])
    assert slid > apart and doubts[0].endswith("see loads, damping and units")
    assert f"NOT a small motion: {slides}" in capsys.readouterr().out
    assert not any("slide farther" in doubt for doubt in run_magnified(tmp_path / "below", 0.9e5 * apart / slid))


def test_wear_of_a_tenth_of_a_body_is_told(monkeypatch):
    """Flanks that are worn alike: the blade moves outwards and is held as before."""
    monkeypatch.setattr(findings, "measure_spacing", lambda _: np.full(6, np.inf))
    for depth, told in ((0.4e-3, 0), (0.6e-3, 1)):
        solution = solve(ContactProblem(dovetail(), ContactLaws(), 300.0, wear=np.full(6, depth)))
        doubts = findings.doubt_small_motion(solution, None, 5e-3)
        assert len(doubts) == told
    assert doubts[0].startswith("surfaces recede by up to 0.6 mm as they wear, a body is only 5 mm thick")


def test_spacing_is_that_to_the_next_pair_of_the_same_flank():
    position = np.array([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0], [0.0, 0.1], [9.0, 9.0]])
    lacking = ("normal", "tangents", "nodes_a", "nodes_b", "normal_gap", "tangential_slip")
    nothing = dict.fromkeys((*lacking, "boundaries", "is_next", "position_b", "drawn_gap"))
    interface = Interface(("a", "b", "c"), np.array([0, 0, 0, 1, 2]), position, area=np.ones(5), **nothing)
    assert measure_spacing(interface) == pytest.approx([1.0, 1.0, 2.0, np.inf, np.inf])
