"""Addresses: which only this computer reaches, and where a server can be heard."""

from __future__ import annotations

import ipaddress
import socket
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

from turnwright.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["is_loopback", "listening"]


def is_loopback(host: str) -> bool:
    """Whether only this computer reaches an address.

    >>> is_loopback("127.0.0.1"), is_loopback("localhost"), is_loopback("::1"), is_loopback("0.0.0.0")
    (True, True, True, False)
    """
    if host.casefold() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


@contextmanager
def listening(host: str, port: int) -> Iterator[tuple[socket.socket, str]]:
    """Yield a socket that is to listen, and the address of the page.

    Parameters
    ----------
    host
        A number or a name of this computer.
    port
        0 for any that is free.

    Raises
    ------
    InputError
        If nothing can be heard there.
    """
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        door = socket.socket(family, kind, protocol)
    except (OSError, UnicodeError) as error:  # a name of no length, or too long, has no place in a look-up
        raise _deaf(host, port, error) from error
    with door:
        try:
            if sys.platform == "win32":  # where "reuse" lets a second server in beside the first
                door.setsockopt(socket.SOL_SOCKET, socket.SO_EXCLUSIVEADDRUSE, 1)
            else:
                door.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            door.bind(place)
        except OSError as error:
            raise _deaf(host, port, error) from error
        number = door.getsockname()[1]
        name = host
        try:
            address = ipaddress.ip_address(host)
        except ValueError:
            pass
        else:
            if address.is_unspecified:
                name = socket.gethostname()
            elif address.version == 6:
                name = f"[{host}]"
        yield door, f"http://{name}:{number}"


def _deaf(host: str, port: int, error: OSError | UnicodeError) -> InputError:
    if isinstance(error, UnicodeError):
        return InputError(f"no server can listen at {host[:60]!r}, which is no name of a computer: name another --host")
    return InputError(
        f"no server can listen at {host}:{port} ({error.strerror}): name another --port, or 0 for any that is free"
    )
