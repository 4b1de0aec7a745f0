"""The text of GeoJSON files: a line for each feature, so that who compares two files sees which have changed."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any


def format_features(head: Mapping[str, Any], features: Iterable[Mapping[str, Any]]) -> str:
    """Return the text of a FeatureCollection, whose other members are in `head`."""
    lines = ",\n".join(json.dumps(feature, allow_nan=False) for feature in features)
    return f'{json.dumps(head, allow_nan=False)[:-1]}, "features": [\n{lines}\n]}}\n'
