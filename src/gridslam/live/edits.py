"""Edits of a finished run's map, as the page reads and saves them."""

from __future__ import annotations

import asyncio
import hashlib
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import final

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from gridslam.errors import GridslamError, InputError
from gridslam.io.edited_maps import MapEdits, anchor_edits
from gridslam.io.edits import Edits, parse_edits, read_edits, write_edits
from gridslam.io.maps import read_map
from gridslam.io.text import compute_digest, parse_json_object
from gridslam.live.downloads import is_authorized, is_foreign
from gridslam.types import OccupancyGrid

EDITS_NAME = "edits.geojson"
_MOST_BYTES = 1 << 23
_CHANGED = "another page, or a run that goes on, has saved edits since: reload, or view it again, to see them"


@final
class EditsFile:
    """The file of edits beside a map, or beside a session.

    Parameters
    ----------
    path : Path
        The file; it need not be there.
    grid : OccupancyGrid
        The map that is shown.
    of_map : MapEdits
        What the edits follow. Those of a session's other maps stay in the file as they are, and are not shown.

    Raises
    ------
    InputError
        The file is damaged, or another map's.
    """

    def __init__(self, path: Path, grid: OccupancyGrid, of_map: MapEdits) -> None:
        """Read the edits, if there are any, and move these to where the map is now."""
        self.path = path
        self._grid = grid
        self._map = of_map
        self._lock = Lock()
        self._stored = self._digest()
        edits = read_edits(path) if self._stored else Edits()
        shown, self._others = (of_map.carry(edits, path, grid), ()) if of_map.sha256 else of_map.split(edits)
        self._text = self._complete(shown).to_text()

    @classmethod
    def of_folder(cls, folder: str | Path) -> EditsFile:
        """Read ``edits.geojson`` of ``map.yaml`` in OUT of `gridslam map` or `grid`; raises InputError without one."""
        path = Path(folder) / "map.yaml"
        return cls(path.with_name(EDITS_NAME), read_map(path), MapEdits.of(path))

    def read(self) -> tuple[str, str]:
        """Return the edits that are shown and the tag of this state of them."""
        text = self._text  # a save may replace it at any time
        return text, hashlib.sha256(text.encode()).hexdigest()

    def save(self, body: bytes, tag: str) -> str:
        """Check and write edits, all or nothing, and return the tag of this state.

        Raises
        ------
        InputError
            A feature is none, or the edits are no longer those of this tag, or another program has written the file.
        OutputError
            The file cannot be written.
        """
        edits = parse_edits(parse_json_object(body, self.path), self.path)
        self._map.require_inside(edits, self.path, self._grid)
        edits = self._complete(edits)
        with self._lock:
            if tag != self.read()[1] or self._digest() != self._stored:
                raise InputError(self.path, _CHANGED)
            write_edits(self.path, replace(edits, edits=(*edits.edits, *self._others)))
            self._stored = self._digest()
            self._text = edits.to_text()
            return self.read()[1]

    def _digest(self) -> str:
        """SHA-256 of the file; empty without one."""
        return compute_digest(self.path) if self.path.exists() else ""

    def _complete(self, edits: Edits) -> Edits:
        edits = anchor_edits(edits, self._map.trajectories)
        return replace(edits, map_name=self._map.path.name, map_sha256=self._map.sha256)


def make_edit_route(file: EditsFile, token: str | None) -> Route:
    """Return the route by which pages with the token read and save edits."""

    async def answer(request: Request) -> Response:
        if not is_authorized(request, token):
            return PlainTextResponse("this needs the token of the page", 403)
        if request.method != "PUT":
            text, tag = file.read()
            return Response(text, media_type="application/geo+json", headers={"etag": f'"{tag}"'})
        if is_foreign(request):
            return PlainTextResponse("this page is another one's", 403)
        body = bytearray()
        async for block in request.stream():
            body += block
            if len(body) > _MOST_BYTES:
                return PlainTextResponse(f"expected edits of at most {_MOST_BYTES} bytes", 413)
        try:
            tag = await asyncio.to_thread(file.save, bytes(body), request.headers.get("if-match", "").strip('"'))
        except GridslamError as error:
            return PlainTextResponse(str(error).removeprefix(f"{file.path}: "), 409)
        return PlainTextResponse("saved", headers={"etag": f'"{tag}"'})

    return Route(f"/{EDITS_NAME}", answer, methods=["GET", "PUT"])
