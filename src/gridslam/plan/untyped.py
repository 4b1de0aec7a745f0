"""Functions of libraries that declare no types, as plans use them: SciPy, and the extra ``map``."""

from __future__ import annotations

from typing import Any

from scipy import fft as _fft
from scipy import ndimage as _ndimage
from scipy import spatial as _spatial
from scipy.sparse import coo_matrix as _coo_matrix
from scipy.sparse import csgraph as _csgraph

from gridslam.errors import MissingDependencyError

fft: Any = _fft
ndimage: Any = _ndimage
spatial: Any = _spatial
coo_matrix: Any = _coo_matrix
connected_components: Any = _csgraph.connected_components


def require_map_extra() -> tuple[Any, Any]:
    """Import contourpy and shapely.

    Raises
    ------
    MissingDependencyError
        One of them is not installed; the extra ``map`` brings them.
    """
    try:
        import contourpy
        import shapely
    except ImportError as error:
        raise MissingDependencyError("a floor plan", str(error.name), "map") from None
    return contourpy, shapely
