"""Touch a nonlinear soft organ: scenes, finite-element solves, blobs, controllers and recordings.

Data flow, with arrays of numpy at every step::

    Scene (file, dict or arrays) -> Scene.path              forces along a loading path
                                 -> Scene.identify          constants from measured forces
                                 -> Scene.precompute, pack  -> Organ -> Organ.force, Controller
                                 -> Live                    solved while the tool touches
    Recording                    ticks of the haptic loop as columns

All quantities are in SI units: m, N, J, Pa, s. Positions are arrays (n, 3). The force h is that of the tool
on the body; what is for the hand is named ``hand_*``. Numbers of the solver are float64, those of the
real-time side float32.

Errors are :class:`InputError` (a ``ValueError``) and :class:`SolveError` (a ``RuntimeError``), both a
:class:`PalpateError`, with one line that names the cause and the fix. Long calls end on Ctrl-C.
"""

from ._errors import InputError, PalpateError, SolveError
from ._identify import Identified, Parameter
from ._palpate import Command, Controller, Organ, __version__
from ._path import Path
from ._recording import Recording
from ._scene import Live, Scene, pack

__all__ = [
    "Command",
    "Controller",
    "Identified",
    "InputError",
    "Live",
    "Organ",
    "PalpateError",
    "Parameter",
    "Path",
    "Recording",
    "Scene",
    "SolveError",
    "__version__",
    "pack",
]
