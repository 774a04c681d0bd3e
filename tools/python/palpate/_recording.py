"""Recordings of the haptic loop."""

from __future__ import annotations

import json
import os
from typing import Any, Iterator, Mapping, Optional, Union

import numpy as np
from numpy.typing import NDArray

from . import _palpate


class Recording(Mapping[str, NDArray[Any]]):
    """The ticks of a recording (.mcap) as columns.

    ``recording["hand_force_n"]`` is a column with one row a tick; ``list(recording)`` names them all. Vectors
    are float32 (n, 3) in the frame of the model, NaN where the tick has none. ``device``, ``coverage``,
    ``phase`` and ``fault`` are texts, empty for none; ``engaged`` is -1 and times are 0 for none.
    docs/formats.md, section 6, describes the fields.

    Raises
    ------
    InputError
        If the file is no recording, or damaged. A truncated file is read up to its end, see ``is_cut``.
    """

    header: dict[str, Any]
    """Settings of the session, as texts."""
    end: Optional[dict[str, Any]]
    """The end of the session; None if the file is cut."""
    is_cut: bool
    """Whether the file ends before the recording does."""
    lost: int
    """Number of missing ticks."""

    def __init__(self, path: Union[str, os.PathLike[str]]) -> None:
        read = _palpate.read_recording(path)
        self._columns: dict[str, NDArray[Any]] = dict(read["columns"])
        for name, words in read["names"].items():
            # The code -1, none, is the last word.
            self._columns[name] = np.array([*words, ""])[self._columns[name]]
        self.header = json.loads(read["header"])
        self.end = None if read["end"] is None else json.loads(read["end"])
        self.is_cut = read["is_cut"]
        self.lost = read["lost"]

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Times of the ticks since the start of the loop (n,), s."""
        seconds: NDArray[np.float64] = 1e-6 * self._columns["t_us"]
        return seconds

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def __repr__(self) -> str:
        return f"Recording({len(self._columns['tick'])} ticks, scene {self.header.get('scene')!r})"
