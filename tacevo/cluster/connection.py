"""Ray itself: looked for, imported only here and below, connected to or started, and kept quiet."""

import contextlib
import logging
import os
import re
import secrets
import signal
import socket
from collections.abc import Iterator, Sequence
from typing import Any

from tacevo.cluster.node_report import TOKEN, keys_here
from tacevo.environment import install
from tacevo.errors import ConfigError
from tacevo.sandbox.protocol import describe

#: The names of the environment variables that a Ray of ours inherits, unless they hold a key.
_KEPT = re.compile(
    r"PATH|HOME|USER|LOGNAME|SHELL|LANG|LC_\w+|TZ|TMPDIR|LD_LIBRARY_PATH|VIRTUAL_ENV|XDG_\w+"
    r"|(PYTHON|CUDA|NVIDIA|RAY|TACEVO)_?\w*"
)

#: Bytes of the object store of a Ray that we start; what does not fit goes to its disk.
_STORE = 256 * 2**20

#: No figures to Ray's makers, no notice about GPUs, patience on a busy machine, and no second Ray that a late call
#: starts; a user's own settings stay.
_SETTINGS = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    "RAY_raylet_start_wait_time_s": "120",
    "RAY_ENABLE_AUTO_CONNECT": "0",
}

#: The variable that says how a cluster knows its users. Without a token, whoever reaches a port of Ray runs code as its
#: user.
_MODE = "RAY_AUTH_MODE"

_ANSWERS = "start it by `ray start --head`; where it asks for a token, set RAY_AUTH_MODE and RAY_AUTH_TOKEN as there"

_WRITES = "see that TMPDIR, where Ray writes, has room and a short name"


_HEAD = re.compile(r"(?P<host>[^\s:/\[\]]+|\[[0-9a-fA-F:]+\]):(?P<port>\d{1,5})")

#: Seconds in which a head must take a connection.
_WAIT = 10.0


def check_head(address: str) -> None:
    """Check that something listens at the address of a head, for which Ray would wait for minutes.

    `auto` is left to Ray.

    Raises:
        ConfigError: it is not HOST:PORT, or nothing takes a connection there.
    """
    if address == "auto":
        return
    place, head = "executor.address", _HEAD.fullmatch(address)
    if head is None or not 0 < int(head["port"]) < 2**16:
        expected = "HOST:PORT of a Ray head, as `ray start --head` prints it, or auto"
        raise ConfigError(address, place=place, expected=expected)
    try:
        socket.create_connection((head["host"].strip("[]"), int(head["port"])), timeout=_WAIT).close()
    except OSError as error:
        raise ConfigError(
            f"{address}: {error.strerror or error}",
            place=place,
            expected="the address of a Ray head that listens",
            remedy="start it by `ray start --head`, or leave executor.address out",
        ) from error


def import_ray(address: str | None) -> Any:
    """Return the module `ray`; a cluster that is started here, without an address, has a token of its own.

    Raises:
        ConfigError: it is not installed.
    """
    guard = {_MODE: "token", TOKEN: secrets.token_hex(32)} if address is None else {}
    for name, value in {**_SETTINGS, **guard}.items():
        os.environ.setdefault(name, value)  # read when it is imported
    try:
        import ray
    except ImportError as error:
        raise ConfigError(str(error), place="executor=ray", expected="Ray", remedy=install("ray")) from error
    return ray


def connect(address: str | None, workers: int) -> Any:
    """Connect to the cluster of an address, or start a Ray of so many slots that ends with this process.

    Returns:
        The module `ray`, connected.

    Raises:
        ConfigError: Ray is not installed, or no cluster of its version answers there.
    """
    ray = import_ray(address)
    started = (
        {"num_cpus": workers, "include_dashboard": False, "object_store_memory": _STORE} if address is None else {}
    )
    handler = signal.getsignal(signal.SIGTERM)
    try:
        with kept_environment() if address is None else contextlib.nullcontext():
            ray.init(
                address="local" if address is None else address,
                log_to_driver=False,
                logging_level=logging.CRITICAL,
                **started,
            )
    except Exception as error:  # Ray's, gRPC's or the system's
        raise ConfigError(
            describe(error),
            place="executor.address" if address else "executor=ray",
            expected="a Ray cluster that answers" if address else "Ray to start",
            remedy=_ANSWERS if address else _WRITES,
        ) from error
    finally:
        signal.signal(signal.SIGTERM, handler)  # Ray puts its own there
    ray._private.worker._worker_logs_enabled = False  # what it says of lost nodes would stand among our own lines
    return ray


@contextlib.contextmanager
def kept_environment() -> Iterator[None]:
    """Take everything out of the environment that a Ray started here need not inherit; put it back at the end."""
    keys = keys_here()
    hidden = {name: os.environ.pop(name) for name in list(os.environ) if name in keys or not _KEPT.fullmatch(name)}
    try:
        yield
    finally:
        os.environ.update(hidden)


def is_guarded() -> bool:
    """Tell whether Ray asks for a token."""
    return os.environ.get(_MODE, "").lower() == "token"


def leave(ray: Any, processes: Sequence[Any], *, is_lost: bool) -> None:
    """End the processes of this run and the connection; where the head is gone, its nodes end them."""
    if not is_lost:
        with contextlib.suppress(Exception):  # Ray ends them too, later, when it sees that their owner is gone
            for process in processes:
                ray.kill(process)
    ray.shutdown()
