"""Constants of materials from measured forces."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._errors import InputError

if TYPE_CHECKING:
    from ._scene import Scene

# Keys of a dictionary of measurements: columns of the table with one or with three components.
_LENGTHS = {"displacement_m": ("dx_m", "dy_m", "dz_m"), "position_m": ("x_m", "y_m", "z_m"), "depth_m": ("depth_m",)}
_WORDS = ("test", "active")


@dataclass(frozen=True)
class Parameter:
    """An identified constant, in the unit at the end of its name."""

    value: float
    low: float
    """Lower end of the interval."""
    high: float
    """Upper end of the interval."""
    standard_error: float
    initial: float
    """Value of the scene, where the fit began."""
    is_at_bound: bool
    """Whether the value is at a bound; it then has no interval."""


@dataclass(frozen=True)
class Identified:
    """The result of :meth:`Scene.identify` with p constants from n rows."""

    parameters: dict[str, Parameter]
    confidence: float
    """Confidence of the intervals."""
    correlation: NDArray[np.float64]
    """Correlations of the constants (p, p)."""
    rms_residual_n: float
    """RMS residual of a force component, N."""
    rms_share: float
    """The same over the RMS of the measured components."""
    is_misfit: bool
    """Whether the residuals are systematic, so that the model does not describe the data."""
    warnings: list[str]
    """What the data cannot tell, one sentence each."""
    displacement_m: NDArray[np.float64]
    """Displacements of the tool (n, 3), m."""
    measured_n: NDArray[np.float64]
    """Measured forces on the body (n, 3), or (n, 1) along the direction, N."""
    model_n: NDArray[np.float64]
    """The same of the model, N."""
    scene: Scene
    """The scene with the constants."""


def table(data: Mapping[str, ArrayLike]) -> str:
    """The measurements of a dictionary as the table that the fit reads."""
    columns: dict[str, list[str]] = {}

    def add(key: str, names: tuple[str, ...]) -> None:
        found = np.asarray(data[key], dtype=np.float64)
        rows = found[:, None] if found.ndim == 1 else found
        if rows.ndim != 2 or rows.shape[1] != len(names):
            shape = "(n,)" if len(names) == 1 else "(n, 3)"
            raise InputError(f'data["{key}"]: shape {shape} is expected, not {found.shape}; give one row for each place')
        for name, column in zip(names, rows.T):
            columns[name] = [repr(float(value)) for value in column]

    places = [key for key in _LENGTHS if key in data]
    if len(places) != 1 or "force_n" not in data:
        raise InputError(f"data: one of {', '.join(_LENGTHS)} is needed, and force_n; it has {', '.join(data)}")
    unknown = [key for key in data if key not in (*_LENGTHS, *_WORDS, "force_n")]
    if unknown:
        raise InputError(f'data["{unknown[0]}"] is not known; use {", ".join((*_LENGTHS, "force_n", *_WORDS))}')
    add(places[0], _LENGTHS[places[0]])
    add("force_n", ("force_n",) if np.ndim(data["force_n"]) == 1 else ("fx_n", "fy_n", "fz_n"))
    for key in _WORDS:
        if key in data:
            columns[key] = [str(word).replace('"', "'") for word in np.asarray(data[key]).ravel()]
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) != 1:
        counts = ", ".join(f"{name} {count}" for name, count in lengths.items())
        raise InputError(f"data: the columns differ in length ({counts}); give one row for each place")
    quoted = ([f'"{cell}"' for cell in row] for row in zip(*columns.values()))
    return "\n".join([",".join(columns), *(",".join(row) for row in quoted)]) + "\n"


def result(fitted: Scene, found: str) -> Identified:
    """The result that the extension module gives as JSON."""
    of: dict[str, Any] = json.loads(found)
    parameters = {entry.pop("name"): Parameter(**entry) for entry in of["parameters"]}
    for line in of["warnings"]:
        warnings.warn(line, stacklevel=3)

    def columns(key: str) -> NDArray[np.float64]:
        return np.array([row[key] for row in of["rows"]], dtype=np.float64)

    kept = ("confidence", "rms_residual_n", "rms_share", "is_misfit", "warnings")
    return Identified(
        parameters=parameters,
        correlation=np.array(of["correlation"], dtype=np.float64),
        displacement_m=columns("displacement_m"),
        measured_n=columns("measured_n"),
        model_n=columns("model_n"),
        scene=fitted,
        **{key: of[key] for key in kept},
    )
