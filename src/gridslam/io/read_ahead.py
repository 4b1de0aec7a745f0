"""Reading ahead: another thread unpacks the next block of a file while the last one is worked on."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextvars import copy_context
from typing import Generic, TypeVar

__all__ = ["read_ahead"]

_Item = TypeVar("_Item")


def read_ahead(items: Callable[[], Iterator[_Item]], most: int = 2) -> Iterator[_Item]:
    """Yield items that another thread makes while the last one is used.

    An exception of theirs is raised where its item would have been. The thread has ended when the iteration has, also
    where that ends early.

    Parameters
    ----------
    items : callable
        Gives the iterator, which the other thread alone uses.
    most : int, >= 1
        Items that wait, at most.
    """
    line = _Line[_Item](items, most)
    context = copy_context()  # the limits of readers
    thread = threading.Thread(target=context.run, args=(line.fill,), name="gridslam reading ahead", daemon=True)
    thread.start()
    try:
        yield from line.take()
    finally:
        line.close()
        thread.join()


class _Line(Generic[_Item]):
    """Items between the thread that makes them and the one that takes them."""

    def __init__(self, items: Callable[[], Iterator[_Item]], most: int) -> None:
        """Start empty."""
        self._items = items
        self._most = most
        self._waiting: deque[_Item] = deque()
        self._changed = threading.Condition()
        self._is_over = False  # nothing follows what waits
        self._is_closed = False  # nobody takes any more
        self._error: BaseException | None = None

    def fill(self) -> None:
        """Put all items in line; ends early when the line is closed."""
        try:
            for item in self._items():
                with self._changed:
                    self._changed.wait_for(lambda: len(self._waiting) < self._most or self._is_closed)
                    if self._is_closed:
                        return
                    self._waiting.append(item)
                    self._changed.notify_all()
        except BaseException as error:  # it is raised again by who takes the items
            self._error = error
        finally:
            with self._changed:
                self._is_over = True
                self._changed.notify_all()

    def take(self) -> Iterator[_Item]:
        """Yield the items; re-raises exceptions of the thread that makes them."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: bool(self._waiting) or self._is_over)
                if not self._waiting:
                    break
                item = self._waiting.popleft()
                self._changed.notify_all()
            yield item
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """Take no more items."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
