"""How the parameters of all models are checked: unknown names, infinities and NaN are errors."""

from __future__ import annotations

from pydantic import ConfigDict

__all__ = ["STRICT"]

STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
