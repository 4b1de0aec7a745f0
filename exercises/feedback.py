"""Feedback of the checks: name the mistake of a wrong result, if it is a typical one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["expect", "require"]


def require(holds: bool, sentence: str) -> None:
    """Raise AssertionError with a sentence unless something holds."""
    if not holds:
        raise AssertionError(sentence)


def expect(
    name: str,
    got: ArrayLike,
    wanted: ArrayLike,
    tolerance: ArrayLike = 1e-7,
    mistakes: Mapping[str, ArrayLike] | None = None,
) -> None:
    """Compare a result with the expected one.

    Parameters
    ----------
    name : str
        What is compared, at the begin of a message.
    got, wanted : array_like of numbers
    tolerance : array_like
        Greatest difference, broadcast to the shape of `wanted`.
    mistakes : mapping of sentences to array_like
        The results of typical mistakes: that which equals `got` is named.

    Raises
    ------
    AssertionError
        If the result differs.
    """
    right = np.asarray(wanted, np.float64)
    try:
        result = np.asarray(got, np.float64)
    except (TypeError, ValueError):
        raise AssertionError(f"{name}: expected numbers of shape {right.shape}, got {got!r}") from None
    if _agree(result, right, tolerance):
        return
    for sentence, value in (mistakes or {}).items():
        if _agree(result, np.asarray(value, np.float64), tolerance):
            raise AssertionError(f"{name}: {sentence}")
    if result.shape != right.shape:
        raise AssertionError(f"{name}: expected shape {right.shape}, got {result.shape}")
    if not np.isfinite(result).all():
        raise AssertionError(f"{name}: a number is not finite (a division by 0, or an overflow)")
    shown = {"precision": 4, "suppress_small": True, "separator": ", "}
    raise AssertionError(f"{name}: expected {_show(right, shown)}, got {_show(result, shown)}")


def _agree(one: NDArray[np.float64], other: NDArray[np.float64], tolerance: ArrayLike) -> bool:
    if one.shape != other.shape:
        return False
    with np.errstate(invalid="ignore"):
        close = np.abs(one - other) <= tolerance
    return bool((close | (one == other) | (np.isnan(one) & np.isnan(other))).all())


def _show(values: NDArray[np.float64], options: Mapping[str, object]) -> str:
    """Write few numbers in full, many by their first ones."""
    few = values if values.size <= 9 else values.ravel()[:6]
    text = " ".join(np.array2string(few, **options).split())  # type: ignore[call-overload]
    return text if values.size <= 9 else f"{text[:-1]}, ...]"
