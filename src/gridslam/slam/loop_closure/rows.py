"""Tables that grow by rows, in memory as one array."""

from __future__ import annotations

from functools import partial
from typing import Generic, TypeVar, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Number = TypeVar("_Number", np.float64, np.int32)


@final
class Rows(Generic[_Number]):
    """Rows of `width` numbers: appending takes constant time, and all rows are one array."""

    __slots__ = ("_count", "_table")

    def __init__(self, width: int, dtype: type[_Number]) -> None:
        self._table: NDArray[_Number] = np.empty((16, width), dtype)
        self._count = 0

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._count

    @property
    def array(self) -> NDArray[_Number]:
        """All rows (N, width), in place: writing to them changes the table, and appending may leave them behind."""
        rows: NDArray[_Number] = self._table[: self._count]
        return rows

    def append(self, row: ArrayLike) -> None:
        """Append a row."""
        if self._count == len(self._table):
            self._table = np.concatenate([self._table, np.empty_like(self._table)])
        self._table[self._count] = row
        self._count += 1

    def extend(self, rows: NDArray[_Number]) -> None:
        """Append rows (K, width)."""
        self._table = np.concatenate([self.array, rows, np.empty_like(self._table[:16])])
        self._count += len(rows)

    def truncate(self, count: int) -> None:
        """Forget all but the first rows."""
        self._count = min(self._count, count)

    def copy(self) -> Rows[_Number]:
        """Return a table of its own."""
        twin: Rows[_Number] = object.__new__(Rows)
        twin._table = self._table.copy()
        twin._count = self._count
        return twin

    def clear(self) -> None:
        """Forget all rows."""
        self._count = 0


new_poses = partial(Rows[np.float64], 3, np.float64)
