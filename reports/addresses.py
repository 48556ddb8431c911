"""Where servers listen: at this machine alone, unless told."""

from __future__ import annotations

import ipaddress
import socket

from gvr_core.errors import ConfigError


def check_address(host: str, exposed: bool = False) -> None:
    """Refuse an address that other machines reach; nothing here asks for a password.

    Args:
        host: The address to listen at.
        exposed: Any address will do: whoever reaches it is trusted.

    Raises:
        ConfigError: for an address that is not loopback.
    """
    if exposed or host == "localhost":
        return
    try:
        if ipaddress.ip_address(host).is_loopback:
            return
    except ValueError:
        pass  # a name, which may stand for any machine
    raise ConfigError(
        f"the address {host!r} can be reached from other machines, and there is no password",
        accepted="127.0.0.1, ::1 or localhost, reached from elsewhere through an SSH tunnel; "
        "or any address with --exposed, where all who reach it are trusted",
    )


def free_port(host: str, port: int) -> int:
    """The port, or any free one for 0; refused while it is still easy to say why.

    Args:
        host: The address to listen at.
        port: 0 to 65535.

    Raises:
        ConfigError: for a port that is taken or out of range.
    """
    if not 0 <= port <= 65535:
        raise ConfigError(f"the port {port}", accepted="0 to 65535, where 0 takes any free one")
    family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    with socket.socket(family, kind, protocol) as probe:
        # As servers do; connections that are still closing then do not count as taken.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(address)
        except OSError as error:
            raise ConfigError(
                f"the port {port} of {host} cannot be used: {error.strerror}",
                accepted="a free port, or 0 for any free one",
            ) from error
        return int(probe.getsockname()[1])
