"""The demos of the paper's studies: shortened in the default run, whole in the slow one; all through the same code."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from ewr_fenicsx import load_scene

DEMOS = Path(__file__).parents[2] / "demos"
STUDIES = ("contact_sets", "normal_forces", "friction_damping", "fretting_wear", "wear_and_response")


@pytest.fixture
def run_study(tmp_path, monkeypatch):
    """Runs a study's ``main`` with its results in a temporary folder; checks what it left there."""
    monkeypatch.syspath_prepend(str(DEMOS))

    def run(name: str, **settings) -> dict:
        figures = importlib.import_module(name).main(tmp_path, **settings)
        content = json.loads((tmp_path / f"{name}.json").read_text())
        assert content["figures"] == json.loads(json.dumps(figures, default=lambda value: value.tolist()))
        assert {v["verdict"] for v in content["verdicts"]} <= {"agrees", "differs", "can't be told"}
        picture = matplotlib.image.imread(tmp_path / f"{name}.png")[..., :3]
        assert 0.005 < (picture < 0.97).any(axis=2).mean() < 0.5, "drawn, and not all over"
        return figures

    yield run
    for name in (*STUDIES, "study"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize("name", STUDIES)
def test_each_study_has_a_scene_that_says_what_it_loads(name, monkeypatch):
    monkeypatch.syspath_prepend(str(DEMOS))
    scene = load_scene(importlib.import_module(name).SCENE)
    assert scene.title.startswith("Blade root")
    assert set(scene.loads) == {"axial_pull", "tip_shake"}


@pytest.mark.slow
def test_contact_sets(run_study):
    run_study("contact_sets")


@pytest.mark.slow
def test_normal_forces(run_study):
    run_study("normal_forces")


def test_friction_damping_in_short(run_study):
    frequencies = np.array([950.0, 1000.0, 1050.0])
    figures = run_study("friction_damping", friction=(0.2, 1.0), frequencies=frequencies, search=False)
    assert figures["mu = 0.2"]["J_T_um"] > figures["mu = 1"]["J_T_um"]


@pytest.mark.slow
def test_friction_damping(run_study):
    figures = run_study("friction_damping")
    assert 0.1 < figures["best friction"] < 0.4
    lowest = min(value["peak_mm"] for key, value in figures.items() if key.startswith("mu = "))
    assert figures["its peak_mm"] < 1.01 * lowest


def test_fretting_wear_in_short(run_study, tmp_path):
    figures = run_study("fretting_wear", cycles=15, friction=(0.4,))
    assert figures["every cycle: solves"] == 16
    assert (tmp_path / "fields" / "worn_gap.xdmf").exists()
    assert (tmp_path / "fretting_wear.csv").read_text().startswith("cycles,")


@pytest.mark.slow
def test_fretting_wear(run_study):
    figures = run_study("fretting_wear")
    assert figures["in jumps: error over the deepest wear"] < 0.01
    assert figures["in jumps: solves"] < figures["every cycle: solves"] / 20


def test_wear_and_response_in_short(run_study):
    few = {"friction": (0.2, 0.6), "frequencies": (500.0, 1000.0, 1500.0), "sweep": np.array([1000.0, 1050.0])}
    figures = run_study("wear_and_response", cycles=5, **few)
    little = figures["1000 Hz, mu = 0.6"]["J_T_um"]
    assert 0.004 < little[0] < 0.007 and round(little[0], 5) != round(little[0], 3), "digits enough for its change"


@pytest.mark.slow
def test_wear_and_response(run_study):
    run_study("wear_and_response")
