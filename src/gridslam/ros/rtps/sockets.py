"""UDP sockets of a participant: its ports, the network's interfaces, and multicast."""

from __future__ import annotations

import socket
import struct
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from typing import Final, final

from gridslam.errors import ConfigurationError
from gridslam.ros.rtps.wire import Address

MULTICAST: Final = "239.255.0.1"
_MAX_PARTICIPANTS: Final = 120
_BUFFER_BYTES: Final = 1 << 22
_LOCAL_PEERS, _PEERS = 60, 12  # participants of this machine to which discovery is sent without multicast
_SIOCGIFADDR: Final = 0x8915


def find_addresses(interfaces: Sequence[str]) -> list[str]:
    """Return the IPv4 addresses of interfaces, by name or address; of all if none is given, loopback only if alone.

    Raises ConfigurationError for an interface that has none.
    """
    if not interfaces:
        found = [address for address in _all_addresses() if not address.startswith("127.")]
        return found or ["127.0.0.1"]
    addresses = []
    for name in interfaces:
        address = name if name[:1].isdigit() else _address_of(name)
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.bind((address or "none", 0))
        except OSError:
            raise ConfigurationError(f"interface {name}: there is no such IPv4 interface on this machine") from None
        addresses.append(address)
    return addresses


def _all_addresses() -> list[str]:
    found: list[str] = []
    with suppress(OSError, AttributeError):
        found += [address for _, name in socket.if_nameindex() if (address := _address_of(name))]
    if not found:
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect((MULTICAST, 1))  # sends nothing: it only chooses a route
            found.append(str(probe.getsockname()[0]))
    if not found:
        with suppress(OSError):
            found += [str(entry[4][0]) for entry in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)]
    return list(dict.fromkeys(found))


def _address_of(name: str) -> str:
    """Address of an interface by its name, on Linux; empty if it has none."""
    if not sys.platform.startswith("linux"):
        return ""
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        request = struct.pack("256s", name.encode()[:15])
        return socket.inet_ntoa(import_module("fcntl").ioctl(probe.fileno(), _SIOCGIFADDR, request)[20:24])
    return ""


@final
class Sockets:
    """The sockets of a participant (9.6.1: PB 7400, DG 250, PG 2, d0 0, d1 10, d3 11).

    Parameters
    ----------
    domain, interfaces, peers
        As of `Participant`.

    Attributes
    ----------
    receivers : list of socket
        To read from.
    discovery, user : list of (str, int)
        Addresses at which discovery and samples are received.

    Raises
    ------
    ConfigurationError
        An interface does not exist, or no port is free.
    """

    def __init__(self, domain: int, interfaces: Sequence[str] = (), peers: Sequence[str] = ()) -> None:
        if not 0 <= domain <= 232:
            raise ConfigurationError(f"ROS_DOMAIN_ID: expected a number from 0 to 232, got {domain}")
        base = 7400 + 250 * domain
        addresses = find_addresses(interfaces)
        is_local = all(address.startswith("127.") for address in addresses)
        unicast = self._bind_unicast(base, "127.0.0.1" if is_local else "")
        self.receivers = [*unicast]
        self.discovery = [(address, unicast[0].getsockname()[1]) for address in addresses]
        self.user = [(address, unicast[1].getsockname()[1]) for address in addresses]
        self._senders = [self._sender(address) for address in addresses]
        reached = dict.fromkeys([*addresses, "127.0.0.1"])
        with suppress(OSError):  # without multicast, unicast to this machine is left
            self.receivers.append(self._multicast_receiver(base, list(reached)))
        numbers = {"127.0.0.1": _LOCAL_PEERS if is_local else _PEERS, **dict.fromkeys(peers, _PEERS)}
        self._announced: list[Address] = [
            (address, base + 10 + 2 * k) for address, number in numbers.items() for k in range(number)
        ]
        self._multicast: Address = MULTICAST, base

    def announce(self, data: bytes) -> None:
        """Send to everybody in the domain: by multicast, and to the first participants of this machine."""
        for sender in self._senders:
            with suppress(OSError):
                sender.sendto(data, self._multicast)
        for address in self._announced:
            self.send(data, address)

    def send(self, data: bytes, address: Address) -> None:
        """Send to one address; what the network refuses is lost, as a datagram may be."""
        with suppress(OSError):
            self._senders[0].sendto(data, address)

    def close(self) -> None:
        """Close all."""
        for one in (*self.receivers, *self._senders):
            one.close()

    @staticmethod
    def _bind_unicast(base: int, address: str) -> list[socket.socket]:
        """Sockets for discovery and for samples, of the first participant's index that is free."""
        for index in range(_MAX_PARTICIPANTS):
            pair = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
            try:
                for one, port in zip(pair, (base + 10 + 2 * index, base + 11 + 2 * index), strict=True):
                    with suppress(OSError):
                        one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
                    one.bind((address, port))
                    one.setblocking(False)
            except OSError:
                for one in pair:
                    one.close()
            else:
                return pair
        raise ConfigurationError("DDS cannot start: no port of this domain is free")

    @staticmethod
    def _sender(address: str) -> socket.socket:
        one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with suppress(OSError):
            one.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
        try:
            one.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(address))
            one.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
        except OSError as error:
            one.close()
            remedy = "bring it up (ip link set lo up), or choose another by --interface"
            problem = f"DDS cannot start: no network interface is up with {address} ({error.strerror})"
            raise ConfigurationError(f"{problem}: {remedy}") from None
        return one

    @staticmethod
    def _multicast_receiver(port: int, addresses: Sequence[str]) -> socket.socket:
        one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if hasattr(socket, "SO_REUSEPORT"):
            with suppress(OSError):
                one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        one.bind(("", port))
        one.setblocking(False)
        for address in addresses:
            with suppress(OSError):
                group = socket.inet_aton(MULTICAST) + socket.inet_aton(address)
                one.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
        return one
