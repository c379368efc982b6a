"""Check that something listens at an address before Ray is started, which would wait for minutes."""

import re
import socket

from tacevo.errors import ConfigError

_PLACE = "executor.address"
_HEAD = re.compile(r"(?P<host>[^\s:/\[\]]+|\[[0-9a-fA-F:]+\]):(?P<port>\d{1,5})")

#: Seconds in which a head must take a connection.
_WAIT = 10.0


def check_head(address: str) -> None:
    """Check that something listens at the address of a head; `auto` is left to Ray.

    Raises:
        ConfigError: it is not HOST:PORT, or nothing takes a connection there.
    """
    if address == "auto":
        return
    found = _HEAD.fullmatch(address)
    if found is None or not 0 < int(found["port"]) < 2**16:
        raise ConfigError(
            address, place=_PLACE, expected="HOST:PORT of a Ray head, as `ray start --head` prints it, or auto"
        )
    try:
        socket.create_connection((found["host"].strip("[]"), int(found["port"])), timeout=_WAIT).close()
    except OSError as error:
        raise ConfigError(
            f"{address}: {error.strerror or error}",
            place=_PLACE,
            expected="the address of a Ray head that listens",
            remedy="start it by `ray start --head`, or leave executor.address out",
        ) from error
