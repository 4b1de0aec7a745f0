"""Functions of SciPy, which declares no types, as plans use them: with types, in one place."""

from __future__ import annotations

from typing import Any

from scipy import fft as _fft
from scipy import ndimage as _ndimage
from scipy import spatial as _spatial
from scipy.sparse import coo_matrix as _coo_matrix
from scipy.sparse import csgraph as _csgraph

__all__ = ["connected_components", "coo_matrix", "fft", "ndimage", "spatial"]

fft: Any = _fft
ndimage: Any = _ndimage
spatial: Any = _spatial
coo_matrix: Any = _coo_matrix
connected_components: Any = _csgraph.connected_components
