"""What another thread reads ahead comes in order, with its errors, and the thread ends with the iteration."""

from __future__ import annotations

import threading

import pytest

from gridslam.errors import InputError
from gridslam.io.read_ahead import read_ahead


def threads():
    return [thread for thread in threading.enumerate() if thread.name == "gridslam reading ahead"]


def test_items_come_in_order_from_another_thread():
    makers = set()

    def items():
        for number in range(200):
            makers.add(threading.current_thread())
            yield number

    assert list(read_ahead(items)) == list(range(200))
    assert threading.current_thread() not in makers
    assert len(makers) == 1
    assert not threads()


def test_an_error_comes_where_its_item_would_have_been():
    def items():
        yield 1
        raise InputError("log", "damaged")

    ahead = read_ahead(items)
    assert next(ahead) == 1
    with pytest.raises(InputError, match="damaged"):
        next(ahead)
    assert not threads()
