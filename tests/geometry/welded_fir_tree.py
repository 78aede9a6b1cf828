"""The default fir tree with the nodes of both sides of every flank merged: what perfect bonding must reproduce."""

from __future__ import annotations

from pathlib import Path

import gmsh

from ewr_fenicsx.structure.mesh import load_builder


def build() -> None:
    """Adds the welded fir tree to the current gmsh model."""
    with load_builder(Path(__file__).parents[2] / "geometry" / "fir_tree.py") as fir_tree:
        fir_tree.build()
    gmsh.model.mesh.removeDuplicateNodes()
    gmsh.model.mesh.renumberNodes()
