"""The extension module, compiled from Rust. `palpate` exports `Organ`, `Controller` and `Command`."""

import os
from types import TracebackType
from typing import Any, Callable, Optional, Union, final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import Self, disjoint_base

__all__ = ["__version__", "Scene", "Organ", "Command", "Controller", "Live", "identify", "pack", "read_recording"]
__version__: str

_Path = Union[str, os.PathLike[str]]
_Callback = Callable[[str, int, Optional[int]], object]
_Which = Union[int, str, None]
_Mesh = tuple[ArrayLike, NDArray[np.int64], dict[str, list[int]], dict[str, list[int]]]
_Quaternion = tuple[float, float, float, float]

@final
class Scene:
    """A scene with its mesh; the body is built by the first solve."""

    @staticmethod
    def load(path: _Path) -> Scene: ...
    @staticmethod
    def of_json(path: _Path, json: str, mesh: Optional[_Mesh] = None) -> Scene: ...
    def with_value(self, key: str, value: str) -> Scene: ...
    @property
    def name(self) -> str: ...
    @property
    def toml(self) -> str: ...
    @property
    def warnings(self) -> list[str]: ...
    @property
    def active(self) -> list[str]: ...
    @property
    def active_m(self) -> NDArray[np.float64]: ...
    @property
    def normals(self) -> NDArray[np.float64]: ...
    @property
    def nodes_m(self) -> NDArray[np.float64]: ...
    @property
    def tets(self) -> NDArray[np.uint32]: ...
    @property
    def fixed(self) -> list[int]: ...
    @property
    def node_groups(self) -> dict[str, list[int]]: ...
    @property
    def tet_groups(self) -> dict[str, list[int]]: ...
    def path(
        self,
        displacements_m: ArrayLike,
        active: Optional[str] = None,
        layer: bool = False,
        keep_nodes: bool = False,
    ) -> dict[str, Any]: ...
    def precompute(
        self, space: _Path, progress: Optional[_Callback] = None, threads: Optional[int] = None
    ) -> dict[str, dict[str, int]]: ...

@final
class Organ:
    """An organ that can be touched: the spaces of its active nodes. It reads a blob that `palpate.pack` or
    the command line has written.

    Raises InputError with the path for a file that is no sound blob.
    """

    def __new__(cls, path: _Path) -> Organ: ...
    @property
    def scene(self) -> str:
        """Name of the scene."""
    @property
    def law(self) -> str:
        """Name of the material law; of the first one where regions differ."""
    @property
    def max_force_n(self) -> float:
        """Largest force of the device, N; infinite without a device."""
    @property
    def active(self) -> list[str]:
        """Names of the active nodes."""
    @property
    def active_m(self) -> NDArray[np.float32]:
        """Places of the active nodes at rest (a, 3), m."""
    @property
    def normals(self) -> NDArray[np.float32]:
        """Outward normals of the skin at the active nodes (a, 3)."""
    @property
    def radius_m(self) -> NDArray[np.float32]:
        """Radii of the balls of displacements (a,), m."""
    @property
    def surface_m(self) -> NDArray[np.float32]:
        """Vertices of the surface at rest (v, 3), m."""
    @property
    def triangles(self) -> NDArray[np.uint32]:
        """Triangles of the surface (t, 3), counter-clockwise seen from outside."""
    @property
    def methods(self) -> list[str]:
        """Methods that every active node has, the most accurate first."""
    @property
    def certificate(self) -> Optional[dict[str, Any]]:
        """The measured errors of the blob; None if they were not measured."""
    def force(
        self,
        displacements_m: ArrayLike,
        active: _Which = None,
        method: Optional[str] = None,
        out: Optional[NDArray[Any]] = None,
    ) -> NDArray[Any]:
        """Force h of the tool on the body at displacements of an active node, N.

        `displacements_m` (n, 3): displacements from rest, m; of a sphere the way of its centre. float32 and
        float64 are read in place. `active`: name or index. `method`: the most accurate of the blob if None.
        `out` (n, 3): memory for the result, C-contiguous, of the same dtype. Returns (n, 3) of the dtype of
        the displacements. Outside the data the force is continued from the rim; a position that is not finite
        has the force at rest. Other threads of Python run meanwhile.
        """
    def estimate(
        self, displacements_m: ArrayLike, active: _Which = None, method: Optional[str] = None
    ) -> dict[str, NDArray[Any]]:
        """Force, stiffness and energy at displacements of an active node; a few times slower than `force`.

        Returns float32 arrays: `force_n` (n, 3), N; `stiffness_n_m` (n, 3, 3), dh_i/dd_j, N/m; `energy_j`
        (n,), J, NaN where the force is no gradient; `extrapolated` (n,), bool.
        """
    def surface_displacement(self, displacement_m: ArrayLike, active: _Which = None) -> NDArray[np.float32]:
        """Displacements of the surface (v, 3), m, at one displacement of an active node (3,), m."""
    def mesh(self) -> Any:
        """The surface as `pyvista.PolyData`. Needs the package pyvista."""
    def _seconds_in_rust(
        self, displacements_m: NDArray[np.float32], method: Optional[str] = None
    ) -> float: ...

@final
class Command:
    """Result of one tick. Vectors are arrays (3,) of float64 in the frame of the model."""

    @property
    def hand_force_n(self) -> NDArray[np.float64]:
        """Force for the hand after every limit, N."""
    @property
    def reaction_n(self) -> NDArray[np.float64]:
        """Force h of the tool on the body before any limit, N; zero without contact."""
    @property
    def displacement_m(self) -> NDArray[np.float64]:
        """Displacement of the engaged node, m; zero without contact."""
    @property
    def position_m(self) -> NDArray[np.float64]:
        """Position of the tool that the command refers to, m."""
    @property
    def engaged(self) -> Optional[int]:
        """Index of the engaged active node; None without contact."""
    @property
    def coverage(self) -> Optional[str]:
        """The data behind the force: cell, supercell, scattered or extrapolated; None without contact."""
    @property
    def phase(self) -> str:
        """disarmed, active or safe-zero."""
    @property
    def fault(self) -> Optional[str]:
        """The fault of the phase safe-zero; otherwise None."""
    @property
    def clamped(self) -> bool:
        """Whether the force limit reduced the force."""
    @property
    def damped(self) -> bool:
        """Whether the passivity control added damping."""
    @property
    def ramp(self) -> float:
        """Factor of the force after arming, 0 to 1."""
    @property
    def hand_work_j(self) -> float:
        """Work on the hand in this touch, J; negative while it presses."""

@final
class Controller:
    """The controller of the haptic loop: contact, force and limits of one tick at a time, in the time of the
    caller.

    The real-time loop runs the same code in Rust; this one is for simulated hands, tests and studies.
    `record` names a recording (.mcap) to write, which `close` or the end of a `with` block ends. Settings by
    name: `max_force_n`, `max_slew_n_per_s`, `ramp_s`, `fade_s`, `max_position_m`, `max_speed_m_s`,
    `max_stiffness_n_m`, `friction`, `release_height_m`, `margin_j`, `max_damping_n_s_m`, `fault_j`,
    `position_step_m`.
    """

    def __new__(
        cls, organ: Organ, method: Optional[str] = None, record: Optional[_Path] = None, **settings: float
    ) -> Controller: ...
    def arm(self) -> bool:
        """Starts rendering, from zero force. Returns whether the controller is active; after a fault `reset`
        is needed first."""
    def disarm(self) -> None:
        """Stops rendering: the next force is zero."""
    def reset(self) -> None:
        """Clears a fault; the controller is disarmed."""
    @property
    def phase(self) -> str:
        """disarmed, active or safe-zero."""
    def tick(
        self,
        t_us: int,
        position_m: Optional[ArrayLike] = None,
        buttons: int = 0,
        orientation: Optional[_Quaternion] = None,
    ) -> Command:
        """One tick: the force for the hand now.

        `t_us`: time, us, which must not decrease. `position_m` (3,): position of the tool in the frame of the
        model, m, or None without a new sample. `buttons`: one bit a button. `orientation`: quaternion w, x,
        y, z of the grip.
        """
    def close(self) -> None:
        """Ends the recording; without one nothing happens."""
    def __enter__(self) -> Controller: ...
    def __exit__(
        self,
        *_exception: Union[type[BaseException], BaseException, TracebackType, None],
    ) -> None: ...

@disjoint_base
class Live:
    """A scene that is solved where the tool goes, in virtual time."""

    def __new__(cls, scene: Scene, **settings: float) -> Self: ...
    def tick(
        self, t_us: int, position_m: Optional[ArrayLike] = None, orientation: Optional[_Quaternion] = None
    ) -> Command:
        """One tick: the force of the jets that are known. At most one jet is taken.

        `t_us`: time, us; the haptic loop has a tick every 1000 us. `position_m` (3,): position of the tool,
        m.
        """
    def step(self, seconds: Optional[float] = None) -> str:
        """One piece of work of the solver where the last tick was: `solved`, `renewing`, `followed`, `lost`,
        or `idle` if everything near the hand is known. `seconds`: how long the step took; measured if
        None."""
    def solve(self, max_steps: int = 100) -> int:
        """Steps until everything near the hand is known, at most `max_steps` times. Returns the number of
        steps. The ticks that follow take the jets, one each."""
    @property
    def waiting(self) -> int:
        """Number of jets that no tick has taken yet."""
    @property
    def totals(self) -> dict[str, int]:
        """Work since the start: jets, factorisations, landings, lost."""
    def change(self, scene: Scene) -> None:
        """Goes on with a changed scene."""
    def displacements(self) -> NDArray[np.float32]:
        """Displacements of the nodes of the mesh (n, 3), m, in the solved state nearest to the last tick."""

def pack(
    space: _Path,
    blob: _Path,
    methods: list[str],
    held_out: Optional[int] = None,
    discretisation: Optional[int] = None,
    progress: Optional[_Callback] = None,
    threads: Optional[int] = None,
) -> Optional[str]: ...
def read_recording(path: _Path) -> dict[str, Any]: ...

def identify(
    scene: Scene,
    path: _Path,
    table: Optional[str],
    free: list[str],
    bounds: list[tuple[str, float, float]],
    loss: str,
    confidence: float,
    active: Optional[str] = None,
    direction: Optional[tuple[float, float, float]] = None,
    progress: Optional[_Callback] = None,
    threads: Optional[int] = None,
) -> tuple[str, Scene]: ...
