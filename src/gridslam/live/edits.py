"""Edits of a finished run's map, as the page reads and saves them."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import final

from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from gridslam.errors import GridslamError, InputError
from gridslam.io.edited_maps import check_edits, compute_image_digest, require_inside
from gridslam.io.edits import Edits, parse_edits, read_edits, write_edits
from gridslam.io.maps import read_map
from gridslam.io.text import compute_digest, parse_json_object

EDITS_NAME = "edits.geojson"
_MOST_BYTES = 1 << 23
_CHANGED = "another page has saved edits since: reload, or view it again, to see them"


@final
class EditsFile:
    """The file of edits beside a map.

    Parameters
    ----------
    folder : str or Path
        OUT of `gridslam map` or `grid`, with ``map.yaml``; ``edits.geojson`` need not be there.
    on_remark : callable
        Gets a sentence where the edits were drawn on another image of the map.

    Raises
    ------
    InputError
        There is no map, or the file is damaged, or an edit lies outside the map.
    """

    def __init__(self, folder: str | Path, on_remark: Callable[[str], None] = lambda remark: None) -> None:
        """Read the edits, if there are any."""
        map_yaml = Path(folder) / "map.yaml"
        self.path = map_yaml.with_name(EDITS_NAME)
        self._grid = read_map(map_yaml)
        self._map_sha256 = compute_image_digest(map_yaml)
        self._lock = Lock()
        self._stored = self._digest()
        edits = read_edits(self.path) if self._stored else Edits()
        check_edits(edits, self.path, map_yaml, self._grid, on_remark)
        self._text = self._complete(edits).to_text()

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
        require_inside(edits, self.path, self._grid)
        edits = self._complete(edits)
        with self._lock:
            if tag != self.read()[1] or self._digest() != self._stored:
                raise InputError(self.path, _CHANGED)
            write_edits(self.path, edits)
            self._stored = self._digest()
            self._text = edits.to_text()
            return self.read()[1]

    def _digest(self) -> str:
        """SHA-256 of the file; empty without one."""
        return compute_digest(self.path) if self.path.exists() else ""

    def _complete(self, edits: Edits) -> Edits:
        return replace(edits, map_name="map.yaml", map_sha256=self._map_sha256)


def is_foreign(connection: HTTPConnection) -> bool:
    """Return whether a request comes from another site's page."""
    origin = connection.headers.get("origin")
    return origin is not None and origin.partition("://")[2] != connection.headers.get("host")


def make_edit_route(file: EditsFile) -> Route:
    """Return the route by which pages read and save edits."""

    async def answer(request: Request) -> Response:
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
