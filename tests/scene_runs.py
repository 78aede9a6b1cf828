"""Runs of a scene through `ewr run`, and the tables that they write."""

from __future__ import annotations

import csv
import json
from pathlib import Path

from ewr_fenicsx.cli import main


def run_scene(folder: Path, text: str, results: str = "results") -> dict:
    """Write a scene and run it; returns its summary. All is in a folder, the results in one of their own there."""
    (folder / "scene.toml").write_text(text)
    assert main(["run", str(folder / "scene.toml"), "--out", str(folder / results)]) == 0
    return json.loads((folder / results / "summary.json").read_text())


def read_table(path: Path) -> list[dict]:
    """Rows of a CSV file: all numbers but the names of flanks."""
    with path.open() as file:
        return [{k: v if k == "flank" else float(v) for k, v in row.items()} for row in csv.DictReader(file)]
