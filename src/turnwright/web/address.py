"""Network addresses of the server."""

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
    """Whether an address is reachable from this computer only.

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
    """Yield a bound socket and the address of the page.

    Parameters
    ----------
    host
        IP address or host name of this computer.
    port
        Port; 0 selects a free one.

    Raises
    ------
    InputError
        If the address cannot be bound.
    """
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, kind, protocol)
    except (OSError, UnicodeError) as error:  # the host name is empty or too long
        raise _listen_error(host, port, error) from error
    with listener:
        try:
            if sys.platform == "win32":  # where SO_REUSEADDR admits a second server
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_EXCLUSIVEADDRUSE, 1)
            else:
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(place)
        except OSError as error:
            raise _listen_error(host, port, error) from error
        number = listener.getsockname()[1]
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
        yield listener, f"http://{name}:{number}"


def _listen_error(host: str, port: int, error: OSError | UnicodeError) -> InputError:
    if isinstance(error, UnicodeError):
        return InputError(f"--host must be a host name or an address, got {host[:60]!r}")
    return InputError(f"cannot listen on {host}:{port} ({error.strerror}): choose another --port, or 0 for a free one")
