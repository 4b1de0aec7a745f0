"""Downloads of visitors: the map and the trajectory."""

from __future__ import annotations

import asyncio
import io
import secrets
import tempfile
import zipfile
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Protocol, TypeVar

from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Route

from gridslam.io.maps import write_map
from gridslam.io.trajectories import write_tum
from gridslam.types import OccupancyGrid, Trajectory

_Source = TypeVar("_Source")
_BLOCK = 1 << 16
_REFUSED = "this needs the token of the page"


class DownloadableContent(Protocol):
    """The downloadable files; used by the thread of the page's content only."""

    def channel_map(self, channel: int) -> OccupancyGrid | None:
        """Return the map of a channel; None if there is none."""

    def trajectory(self, channel: int) -> Trajectory | None:
        """Return the trajectory of a channel; None if there is none."""


def make_download_routes(
    content: DownloadableContent, token: str | None, thread: ThreadPoolExecutor
) -> list[BaseRoute]:
    """Return the routes of the files, for those who have the token."""

    def make_endpoint(
        find: Callable[[int], _Source | None], make: Callable[[_Source], bytes], media_type: str, missing: str
    ) -> Callable[[Request], Awaitable[Response]]:
        async def send(request: Request) -> Response:
            if not is_authorized(request, token):
                return PlainTextResponse(_REFUSED, 403)
            given = request.query_params.get("channel", "0")
            number = int(given) if given.isdecimal() and len(given) < 10 else 0
            source = await asyncio.wrap_future(thread.submit(find, number))
            if source is None:
                return PlainTextResponse(missing, 404)
            return Response(await asyncio.to_thread(make, source), media_type=media_type)

        return send

    return [
        Route("/map.zip", make_endpoint(content.channel_map, _zip_map, "application/zip", "there is no map")),
        Route(
            "/trajectory.tum",
            make_endpoint(content.trajectory, _format_trajectory, "text/plain", "there is no trajectory"),
        ),
    ]


def is_authorized(connection: HTTPConnection, token: str | None) -> bool:
    """Return whether a request has the token, if one is needed."""
    given = connection.query_params.get("token", "")
    return token is None or secrets.compare_digest(given.encode(), token.encode())


def is_foreign(connection: HTTPConnection) -> bool:
    """Return whether a request comes from another site's page."""
    origin = connection.headers.get("origin")
    return origin is not None and origin.partition("://")[2] != connection.headers.get("host")


def _zip_map(grid: OccupancyGrid) -> bytes:
    """Return a ZIP archive with map.yaml and map.pgm for ROS's map_server."""
    archive = io.BytesIO()
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as files:
        write_map(Path(folder) / "map.yaml", grid)
        for name in ("map.yaml", "map.pgm"):
            files.write(Path(folder) / name, name)
    return archive.getvalue()


def _format_trajectory(trajectory: Trajectory) -> bytes:
    """Return the content of a TUM file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trajectory.tum"
        write_tum(path, trajectory)
        return path.read_bytes()
