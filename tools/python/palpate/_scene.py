"""Scenes, and what is solved of them."""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, Callable, Optional, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _identify, _mesh, _palpate
from ._errors import InputError
from ._identify import Identified
from ._path import Path

FilePath = Union[str, "os.PathLike[str]"]
Progress = Union[bool, None, Callable[[str, int, Optional[int]], object]]
Indices = NDArray[np.int64]


def _plain(value: Any) -> Any:
    """A value for JSON: arrays become lists, and keys without a value are left out."""
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items() if inner is not None}
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(inner) for inner in value]
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return value


def _json(name: str, tables: Mapping[str, Any]) -> str:
    try:
        return json.dumps(_plain(tables), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{name}: {error}; use finite numbers, texts, booleans, lists and dictionaries"
        ) from None


def _indices(name: str, given: ArrayLike, columns: Optional[int] = None) -> Indices:
    """Whole numbers (n,), or (n, columns)."""
    found = np.asarray(given)
    shape = "(n,)" if columns is None else f"(n, {columns})"
    is_right = found.ndim == 1 if columns is None else found.ndim == 2 and found.shape[1] == columns
    if not is_right:
        raise InputError(f"{name}: shape {shape} is expected, not {found.shape}; give one row for each")
    if found.size and found.dtype.kind not in "iu":
        raise InputError(f"{name}: whole numbers are expected, not dtype {found.dtype}; give indices from 0")
    whole = found.astype(np.int64)
    if whole.size and (whole.min() < 0 or whole.max() > np.iinfo(np.uint32).max):
        raise InputError(f"{name}: an index is negative or too large; give indices from 0")
    return np.ascontiguousarray(whole)


def _report(progress: Progress) -> Optional[Callable[[str, int, Optional[int]], object]]:
    """The callback of a `progress` argument; True writes a line to standard error."""
    if progress is True:

        def line(phase: str, done: int, total: Optional[int]) -> None:
            of = "" if total is None else f" of {total}"
            count = "" if done == 0 and total is None else f": {done}{of}"
            print(f"\r\x1b[Kpalpate: {phase}{count}", end="", file=sys.stderr, flush=True)

        return line
    return progress or None


def _end_line(progress: Progress) -> None:
    if progress is True:
        print(file=sys.stderr)


class Scene:
    """A scene: mesh, material, fixed nodes, active nodes and sampling.

    docs/guide.md and docs/formats.md, section 1, describe the tables of a scene file.

    Parameters
    ----------
    path : path
        The scene file (TOML).

    Raises
    ------
    InputError
        With the file, the line, the problem and the fix.
    """

    def __init__(self, path: FilePath) -> None:
        self._begin(_palpate.Scene.load(path))

    def _begin(self, inner: _palpate.Scene) -> None:
        self._inner = inner
        for line in inner.warnings:
            warnings.warn(line, stacklevel=3)

    @classmethod
    def _of(cls, inner: _palpate.Scene) -> Scene:
        scene = cls.__new__(cls)
        scene._begin(inner)
        return scene

    @classmethod
    def from_dict(cls, tables: Mapping[str, Any], folder: FilePath = ".") -> Scene:
        """The scene of a dictionary with the tables of a scene file.

        Parameters
        ----------
        tables : dict
            ``{"mesh": {...}, "material": {...}, "fixed": {...}, "active": [...], ...}``. Values may be
            arrays.
        folder : path
            The folder that relative file names in it refer to.

        Raises
        ------
        InputError
            Its line counts in the text of the scene as TOML.
        """
        path = os.path.join(os.fspath(folder), "<dict>")
        return cls._of(_palpate.Scene.of_json(path, _json("<dict>", tables)))

    @classmethod
    def from_arrays(
        cls,
        nodes_m: ArrayLike,
        tets: ArrayLike,
        *,
        material: Union[Mapping[str, Any], Sequence[Mapping[str, Any]]],
        fixed: Union[str, ArrayLike],
        active: Optional[Mapping[str, Any]] = None,
        groups: Optional[Mapping[str, ArrayLike]] = None,
        regions: Optional[Mapping[str, ArrayLike]] = None,
        order: Union[int, str, None] = None,
        name: str = "arrays",
        **tables: Any,
    ) -> Scene:
        """The scene of a mesh in memory.

        Parameters
        ----------
        nodes_m : array (n, 3)
            Positions of the nodes, m.
        tets : array (m, 4) of whole numbers
            Vertices of each tet, from 0; det[x1-x0, x2-x0, x3-x0] > 0.
        material : dict or list of dict
            The table ``[material]``, or several with a ``group`` of ``regions`` each.
        fixed : str, array or dict
            A name in ``groups``, nodes, or the table ``[fixed]``.
        active : dict
            Node of each active node by its name, or its table: ``{"A1": 199}``. None for a sphere.
        groups, regions : dict
            Nodes and tets by name.
        order : 1, 2 or "tool"
            Order of the elements.
        **tables
            The other tables of a scene: ``grid``, ``tool``, ``device``, ``needs``, ``body_force``,
            ``solver``.

        Raises
        ------
        InputError
            For a wrong shape or dtype, an index that is not there, or an inverted tet, which it names.
        """
        scene: dict[str, Any] = {
            "name": name,
            "mesh": {"file": "<arrays>", "order": order},
            "material": material,
        }
        if isinstance(fixed, str):
            scene["fixed"] = {"group": fixed}
        else:
            scene["fixed"] = fixed if isinstance(fixed, Mapping) else {"nodes": _indices("fixed", fixed)}
        if active is not None:
            of = {key: at if isinstance(at, Mapping) else {"node": at} for key, at in active.items()}
            scene["active"] = [{"name": key, **at} for key, at in of.items()]
        named = {key: _indices(f'groups["{key}"]', of).tolist() for key, of in (groups or {}).items()}
        parts = {key: _indices(f'regions["{key}"]', of).tolist() for key, of in (regions or {}).items()}
        mesh = (nodes_m, _indices("tets", tets, 4), named, parts)
        return cls._of(_palpate.Scene.of_json("<arrays>", _json("<arrays>", {**scene, **tables}), mesh))

    def with_value(self, key: str, value: Any) -> Scene:
        """The scene with one value changed.

        ``key`` is the path of the value with dots: ``material.c10_pa``, or ``material.tumour.c10_pa`` where
        several tables have a group.
        """
        plain = _plain(value)
        return self._of(self._inner.with_value(key, plain if isinstance(plain, str) else json.dumps(plain)))

    @property
    def name(self) -> str:
        """Name of the scene."""
        return self._inner.name

    @property
    def toml(self) -> str:
        """The scene as TOML with sorted keys."""
        return self._inner.toml

    @property
    def active(self) -> list[str]:
        """Names of the active nodes."""
        return self._inner.active

    @property
    def active_m(self) -> NDArray[np.float64]:
        """Places of the active nodes on the undeformed body (a, 3), m."""
        return self._inner.active_m

    @property
    def normals(self) -> NDArray[np.float64]:
        """Outward normals of the skin at the active nodes (a, 3)."""
        return self._inner.normals

    @property
    def nodes_m(self) -> NDArray[np.float64]:
        """Nodes of the mesh (n, 3), m."""
        return self._inner.nodes_m

    @property
    def tets(self) -> NDArray[np.uint32]:
        """Vertices of the tets (m, 4)."""
        return self._inner.tets

    @property
    def fixed(self) -> Indices:
        """Fixed nodes."""
        return np.asarray(self._inner.fixed, dtype=np.int64)

    @property
    def groups(self) -> dict[str, Indices]:
        """Nodes of the groups of the mesh."""
        return {name: np.asarray(of, dtype=np.int64) for name, of in self._inner.node_groups.items()}

    @property
    def regions(self) -> dict[str, Indices]:
        """Tets of the groups of the mesh."""
        return {name: np.asarray(of, dtype=np.int64) for name, of in self._inner.tet_groups.items()}

    def path(
        self,
        displacements_m: ArrayLike,
        active: Optional[str] = None,
        *,
        layer: bool = False,
        keep_nodes: bool = False,
    ) -> Path:
        """The reaction along a loading path; each step starts from the one before.

        Parameters
        ----------
        displacements_m : array (n, 3)
            Displacements of the active node from rest, m; of a sphere or capsule the places of its centre.
        active : str
            The active node; the first if None.
        layer : bool
            Solve a sphere with its elastic layer, as live touch does.
        keep_nodes : bool
            Keep the displacements of all nodes.

        Returns
        -------
        Path
            Up to a step that does not converge: ``failure`` says why.
        """
        columns = self._inner.path(displacements_m, active, layer, keep_nodes)
        steps = np.asarray(displacements_m, dtype=np.float64)[: len(columns["energy_j"])]
        return Path(displacements_m=steps, node_displacements_m=columns.pop("nodes_m", None), **columns)

    def precompute(
        self, space: FilePath, progress: Progress = None, threads: Optional[int] = None
    ) -> dict[str, dict[str, int]]:
        """Solves the configuration spaces of the active nodes into a ``.space`` file, or continues it.

        After Ctrl-C, or a power loss, the same call goes on where it ended.

        Parameters
        ----------
        space : path
            The file to write or to continue.
        progress : bool or callable
            ``progress(phase, done, total)`` a few times a second, ``total`` None if it is not known. True
            writes a line to standard error. An exception of the callback stops the solves like Ctrl-C.
        threads : int
            One a core if None. The numbers do not depend on it.

        Returns
        -------
        dict
            For each active node the numbers of positions: expandable, terminating (beyond the force limit),
            failed, unknown.
        """
        try:
            return self._inner.precompute(space, _report(progress), threads)
        finally:
            _end_line(progress)

    def identify(
        self,
        data: Union[FilePath, Mapping[str, ArrayLike]],
        free: Sequence[str],
        *,
        bounds: Optional[Mapping[str, tuple[Optional[float], Optional[float]]]] = None,
        loss: str = "linear",
        confidence: float = 0.95,
        active: Optional[str] = None,
        direction: Optional[tuple[float, float, float]] = None,
        progress: Progress = None,
        threads: Optional[int] = None,
    ) -> Identified:
        """Constants of the materials from measured forces, by least squares on the finite-element solution.

        Parameters
        ----------
        data : path or dict
            A table (docs/formats.md, section 5), or arrays: ``displacement_m`` (n, 3), ``position_m`` (n, 3) or
            ``depth_m`` (n,); ``force_n`` (n, 3) on the body, or (n,) along the direction; ``test`` and ``active``
            (n,) are optional.
        free : sequence of str
            Constants as in the scene: ``c10_pa``, or ``tumour.c10_pa`` with several materials.
        bounds : dict
            ``{"c10_pa": (0.0, 5000.0)}``; None is no bound.
        loss : "linear", "soft-l1" or "huber"
            How much outliers count.
        confidence : float
            Of the intervals.
        active : str
            Where the tool is, if the data do not say it; the first active node if None.
        direction : three floats
            Of depths and of forces (n,), from the tool into the body.
        progress, threads
            As in :meth:`precompute`.

        Raises
        ------
        InputError, SolveError
            For data that do not suit, and for a fit that does not converge.
        """
        path: FilePath = "<arrays>"
        table: Optional[str] = None
        if isinstance(data, Mapping):
            table = _identify.table(data)
        else:
            path = data
        limits = [
            (name, -np.inf if low is None else float(low), np.inf if high is None else float(high))
            for name, (low, high) in (bounds or {}).items()
        ]
        names = [free] if isinstance(free, str) else list(free)
        options = (names, limits, loss, confidence, active, direction)
        try:
            found, fitted = _palpate.identify(self._inner, path, table, *options, _report(progress), threads)
        finally:
            _end_line(progress)
        # Its warnings are among those of the result.
        scene = Scene.__new__(Scene)
        scene._inner = fitted
        return _identify.result(scene, found)

    def mesh(self, displacements_m: Optional[ArrayLike] = None) -> Any:
        """The body as ``pyvista.UnstructuredGrid``, moved by ``displacements_m`` (n, 3), m.

        It has ``displacement_m`` and ``fixed`` on the nodes and one boolean array a region on the tets. Needs
        the package pyvista.
        """
        return _mesh.volume(self, displacements_m)

    def __repr__(self) -> str:
        return f"Scene({self.name!r}, {len(self.nodes_m)} nodes, {len(self.tets)} tets, active={self.active})"


class Live(_palpate.Live):
    """A scene that is solved where the tool goes, in virtual time.

    ``tick`` is one tick of the haptic loop with the jets that have arrived, ``step`` one piece of work of the
    solver. In a session a process of its own makes the steps; here Python chooses how many follow a tick.

    Parameters
    ----------
    scene : Scene
        Its skin can be touched anywhere.
    **settings : float
        Limits of the controller by name: ``max_force_n``, ``ramp_s`` and others, see :class:`Controller`.
    """

    def __new__(cls, scene: Scene, **settings: float) -> Live:
        return super().__new__(cls, scene._inner, **settings)

    def change(self, scene: Scene) -> None:  # type: ignore[override]
        """Goes on with a changed scene: other materials, body force or fixed nodes of the same mesh."""
        super().change(scene._inner)


def pack(
    space: FilePath,
    blob: FilePath,
    *,
    methods: Sequence[str] = ("energy",),
    held_out: Optional[int] = None,
    discretisation: Optional[int] = None,
    progress: Progress = None,
    threads: Optional[int] = None,
) -> Optional[dict[str, Any]]:
    """Fits the tables of a ``.space`` file, measures their errors, and writes the blob.

    The blob is written whole or not at all. Solved positions are kept in the ``.space`` file.

    Parameters
    ----------
    space, blob : path
        The file to read, and the file to write.
    methods : sequence of str
        trilinear, tricubic, hybrid, rbf-linear, rbf-cubic, hermite, energy, kernel.
    held_out : int
        Positions of the certificate for each active node; 299 if None, 0 for no certificate.
    discretisation : int
        Positions of them that more accurate elements solve too, for a tool with a size.
    progress, threads
        As in :meth:`Scene.precompute`.

    Returns
    -------
    dict
        The certificate, as `palpate inspect --json` prints it; None without one.
    """
    arguments = (space, blob, list(methods), held_out, discretisation, _report(progress), threads)
    try:
        certificate = _palpate.pack(*arguments)
    finally:
        _end_line(progress)
    return None if certificate is None else json.loads(certificate)
