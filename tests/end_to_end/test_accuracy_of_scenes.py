"""A scene that asks for an accuracy, and what the knobs of a scene cost: through files and the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ewr_fenicsx import cost_report
from ewr_fenicsx.chain import build_chain
from ewr_fenicsx.cli import main
from ewr_fenicsx.errors import SceneError
from ewr_fenicsx.scene import load_scene

ROOT = Path(__file__).parents[2]


def write_scene(folder: Path, *more: str) -> Path:
    """The demo with two blocks, and more entries."""
    text = (ROOT / "demos" / "two_blocks.toml").read_text(encoding="utf-8")
    text = text.split("[solver]")[0].replace('"../geometry', f'"{ROOT}/geometry')
    path = folder / "scene.toml"
    path.write_text(text + "\n" + "\n".join(more) + "\n", encoding="utf-8")
    return path


def test_an_accuracy_is_reached_and_told(tmp_path, capsys):
    scene = write_scene(tmp_path, "[solver]", "accuracy = 0.1")
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert "of 0.1 asked (harmonics" in told
    assert "modes" in told, "the chain knows which coordinates are modes"
    assert "NOT as accurate" not in told


@pytest.mark.parametrize(
    ("option", "name"), [((), "harmonic balance, N = 15"), (("--time-stepping",), "time stepping, 200 steps a period")]
)
def test_costs_are_told_and_written(tmp_path, capsys, monkeypatch, option, name):
    monkeypatch.setattr(cost_report, "ORDERS", (1, 3, 5))
    monkeypatch.setattr(cost_report, "HIGHEST", 15)
    monkeypatch.setattr(cost_report, "STEPS", (100, 200))
    folder = tmp_path / "costs"
    assert main(["cost", str(write_scene(tmp_path)), "--out", str(folder), *option]) == 0
    printed = capsys.readouterr()
    assert f"reference: {name}" in printed.out
    assert "settings" in printed.err and "left" in printed.err
    found = json.loads((folder / "cost.json").read_text(encoding="utf-8"))
    errors = {r["value"]: r["errors"]["output"] for r in found["rows"] if r["knob"] == "N"}
    assert set(errors) == {1, 3, 5}
    assert errors[1] > errors[5] > found["own_error"]
    assert (folder / "cost.png").stat().st_size > 10_000


def test_nothing_to_choose_where_nothing_oscillates(tmp_path):
    scene = load_scene(write_scene(tmp_path))
    still = {name: load for name, load in scene.loads.items() if load.harmonic == 0}
    with pytest.raises(SceneError, match="no load oscillates"):
        cost_report.survey_scene(build_chain(scene.model_copy(update={"loads": still})))
