"""Meshes for pyvista, which is imported only here."""

from __future__ import annotations

from typing import Any, Optional

import numpy as np
from numpy.typing import ArrayLike


def _pyvista() -> Any:
    try:
        import pyvista
    except ImportError as error:
        raise ImportError("mesh() needs the package pyvista; install it with: pip install pyvista") from error
    return pyvista


def volume(scene: Any, displacements_m: Optional[ArrayLike]) -> Any:
    """The body of a scene as pyvista.UnstructuredGrid."""
    pyvista = _pyvista()
    nodes, tets = scene.nodes_m, scene.tets
    moved = np.zeros_like(nodes) if displacements_m is None else np.asarray(displacements_m, dtype=float)
    grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: tets}, nodes + moved)
    grid.point_data["displacement_m"] = moved
    fixed = np.zeros(len(nodes), dtype=bool)
    fixed[scene.fixed] = True
    grid.point_data["fixed"] = fixed
    for name, members in scene.regions.items():
        inside = np.zeros(len(tets), dtype=bool)
        inside[members] = True
        grid.cell_data[name] = inside
    return grid


def surface(organ: Any) -> Any:
    """The surface of an organ as pyvista.PolyData."""
    pyvista = _pyvista()
    return pyvista.PolyData.from_regular_faces(organ.surface_m, organ.triangles)
