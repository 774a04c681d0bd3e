"""A solved loading path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Path:
    """The equilibria along a loading path of n steps, of which k were solved."""

    displacements_m: NDArray[np.float64]
    """Displacements of the tool from rest (k, 3), m; of a sphere the places of its centre."""
    force_n: NDArray[np.float64]
    """Force h of the tool on the body (k, 3), N: h = dW/dd."""
    energy_j: NDArray[np.float64]
    """Condensed energy W (k,), J."""
    stiffness_n_m: NDArray[np.float64]
    """Stiffness dh_i/dd_j (k, 3, 3), N/m."""
    torque_n_m: NDArray[np.float64]
    """Moment of the tool on the body about the centre of a patch (k, 3), N m; zero for a single node."""
    volume_m3: NDArray[np.float64]
    """Deformed volume (k,), m^3."""
    min_jacobian: NDArray[np.float64]
    """Smallest determinant of the deformation gradient (k,)."""
    iterations: NDArray[np.uint32]
    """Newton iterations of each step (k,)."""
    switched: NDArray[np.bool_]
    """Whether the step left its branch, so that W, h and S do not continue those before (k,)."""
    node_displacements_m: Optional[NDArray[np.float64]]
    """Displacements of the nodes of the mesh (k, nodes, 3), m, if they were kept."""
    failure: Optional[str]
    """Why the path ended before its last step; None if it is whole."""
