"""Options of the page; importing this module is cheap."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from typing import final

from gridslam.errors import ArgumentError


@final
@dataclass(frozen=True, slots=True)
class LiveOptions:
    """Address of the page, and how it begins.

    Attributes
    ----------
    host : str
        Address to listen on. Only this machine can reach a loopback address; any other is open to the network.
    port : int, [0, 65535]
        Port to listen on; 0: any free port.
    speed : float or None, > 0
        Factor on real time; None: as fast as possible.
    opens : bool
        Whether the page is opened in the default browser.

    Raises
    ------
    ArgumentError
        A number is out of its range.
    """

    host: str = "127.0.0.1"
    port: int = 8642
    speed: float | None = None
    opens: bool = False

    def __post_init__(self) -> None:
        """Check the numbers."""
        if not 0 <= self.port <= 65535:
            raise ArgumentError("port", "a number from 0 to 65535", self.port)
        if self.speed is not None and not self.speed > 0:
            raise ArgumentError("speed", "a number > 0", self.speed)

    @property
    def is_local(self) -> bool:
        """Whether only this machine can reach the page."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"
