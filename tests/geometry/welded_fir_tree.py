"""The default fir tree with the nodes of both sides of every flank merged: what perfect bonding must reproduce."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import gmsh


def build() -> None:
    """Adds the welded fir tree to the current gmsh model."""
    source = Path(__file__).parents[2] / "geometry" / "fir_tree.py"
    specification = importlib.util.spec_from_file_location("fir_tree_to_weld", source)
    module = importlib.util.module_from_spec(specification)
    sys.modules[specification.name] = module  # dataclasses look up the module that defines them
    try:
        specification.loader.exec_module(module)
        module.build()
    finally:
        del sys.modules[specification.name]
    gmsh.model.mesh.removeDuplicateNodes()
    gmsh.model.mesh.renumberNodes()
