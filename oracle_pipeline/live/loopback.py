"""Sockets for live views, which listen on this machine only."""

import socket

from oracle_pipeline.bags.errors import OracleError

HOST = "127.0.0.1"


class PortError(OracleError):
    """A view cannot be served at its port."""


def listen(port: int) -> socket.socket:
    """Return a socket that listens at a port, 0 being any that is free.

    Raises
    ------
    PortError
        If the port is taken.
    """
    try:
        return socket.create_server((HOST, port))
    except OSError as error:
        raise PortError(
            f"Nothing can listen at port {port} of {HOST}: {error.strerror}. Name another port, or "
            "0 for a free one."
        ) from error
