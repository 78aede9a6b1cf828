"""What a mesh holds, for tests on one rank and on several."""

from __future__ import annotations

import numpy as np

from ewr_fenicsx.structure.mesh import JointMesh


def count(mesh: JointMesh) -> dict:
    """Global numbers of everything, the same on every rank."""
    topology = mesh.domain.topology
    dimension = topology.dim
    total = lambda tags, tag, d: mesh.domain.comm.allreduce(  # noqa: E731
        int(np.count_nonzero(tags.find(tag) < topology.index_map(d).size_local))
    )
    return {
        "nodes": mesh.domain.geometry.index_map().size_global,
        "cells": topology.index_map(dimension).size_global,
        "bodies": {name: total(mesh.cell_tags, tag, dimension) for name, tag in mesh.bodies.items()},
        "boundaries": {name: total(mesh.facet_tags, tag, dimension - 1) for name, tag in mesh.boundaries.items()},
    }
