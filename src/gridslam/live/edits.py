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
from gridslam.io.text import parse_json_object
from gridslam.live.downloads import is_authorized, is_foreign

__all__ = ["EDITS_NAME", "EditsFile", "make_edit_route"]

EDITS_NAME = "edits.geojson"
_MOST_BYTES = 1 << 23
_CHANGED = "another page has saved edits since: reload to see them"


@final
class EditsFile:
    """The file of edits beside a map.

    Parameters
    ----------
    folder : str or Path
        OUT of `gridslam map` or `grid`; the file is ``edits.geojson`` in it, the map ``map.yaml``.

    Raises
    ------
    InputError
        There is no map, or the file is there and damaged, or another map's.
    """

    def __init__(self, folder: str | Path) -> None:
        """Read the map and the edits, if there are any, and move these to where the map is now."""
        self.path = Path(folder) / EDITS_NAME
        self._grid = read_map(self.path.with_name("map.yaml"))
        self._map = MapEdits(self.path.with_name("map.yaml"))
        self._lock = Lock()
        edits = read_edits(self.path) if self.path.exists() else Edits()
        self._text = self._complete(edits).to_text()

    def read(self) -> tuple[str, str]:
        """Return the edits and the tag of this state of them."""
        text = self._text  # a save may replace it at any time
        return text, hashlib.sha256(text.encode()).hexdigest()

    def save(self, body: bytes, tag: str) -> str:
        """Check and write edits, all or nothing, and return the tag of this state.

        Raises
        ------
        InputError
            A feature is none, or the edits are no longer those of this tag.
        OutputError
            The file cannot be written.
        """
        edits = self._complete(parse_edits(parse_json_object(body, self.path), self.path))
        with self._lock:
            if tag != self.read()[1]:
                raise InputError(self.path, _CHANGED)
            write_edits(self.path, edits)
            self._text = edits.to_text()
            return self.read()[1]

    def _complete(self, edits: Edits) -> Edits:
        edits = self._map.carry(edits, self.path, self._grid)
        return replace(anchor_edits(edits, self._map.trajectory), map_name=self._map.path.name)


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
