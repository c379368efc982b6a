"""Landlock (landlock(7)): the process gives up the file system, the network and signals to others, for good.

A ruleset names kinds of access that are refused from then on, except where a rule allows them. A candidate on a CPU
needs no access, so there is no rule; the driver of a GPU opens device files, and libraries when it starts. Only
`no_new_privs` must be set. Files that were open before stay open.
"""

import os
import struct
from collections.abc import Collection

from tacevo.sandbox.kernel import system_call

# The same on every architecture, like every call that is as young.
_CREATE_RULESET = 444
_ADD_RULE = 445
_RESTRICT_SELF = 446
_BENEATH = 1  # the kind of rule that names a directory, or a file
_ASK_VERSION = 1
#: The number of kinds of file access that each version of the interface knows; later ones know as many as the last.
_FILE_ACCESSES = {1: 13, 2: 14, 3: 15, 4: 15, 5: 16}
#: The first version that knows: TCP bind and connect; abstract Unix sockets and signals of others.
NETWORK_SINCE, SCOPES_SINCE = 4, 6
_BIND_AND_CONNECT = 0b11
_SOCKETS_AND_SIGNALS = 0b11
#: Kinds of access to files, by bit: write, read, list a directory, and from version 5 ioctl on a device.
_WRITE, _READ, _LIST, _IOCTL = 1 << 1, 1 << 2, 1 << 3, 1 << 15


def version() -> int:
    """Return the version of the kernel's interface (its ABI); 0 where Landlock is missing or switched off."""
    try:
        return system_call(_CREATE_RULESET, 0, 0, _ASK_VERSION)
    except OSError:
        return 0


def refused(known: int) -> tuple[int, int, int]:
    """Return everything that a version of the interface, at least 1, can refuse, as bits.

    They are kinds of access to files, of access to the network, and of reaching processes outside.
    """
    files = (1 << _FILE_ACCESSES.get(known, max(_FILE_ACCESSES.values()))) - 1
    network = _BIND_AND_CONNECT if known >= NETWORK_SINCE else 0
    return files, network, _SOCKETS_AND_SIGNALS if known >= SCOPES_SINCE else 0


def restrict(*, readable: Collection[str] = (), devices: Collection[str] = ()) -> None:
    """Take from this thread, and from all that it starts, everything that Landlock can refuse but what is named.

    It opens files for a moment, so it comes before a limit on open files. Called again, it only takes more.

    Args:
        readable: directories beneath which files may be read and listed.
        devices: files that may be read, written and, being devices, controlled by ioctl; of directories, the files in
            them.

    Raises:
        OSError: Landlock is missing, `no_new_privs` is not set, or a path that is named is not there.
    """
    files, network, scopes = refused(version())
    ruleset = struct.pack("=QQQ", files, network, scopes)  # a kernel accepts last fields that it does not know as 0
    descriptor = system_call(_CREATE_RULESET, ruleset, len(ruleset), 0)
    try:
        for path in readable:
            _allow(descriptor, path, _READ | _LIST)
        for path in devices:
            _allow(descriptor, path, files & (_READ | _WRITE | _IOCTL))
        system_call(_RESTRICT_SELF, descriptor, 0)
    finally:
        os.close(descriptor)


def _allow(ruleset: int, path: str, access: int) -> None:
    """Except a file, or what lies beneath a directory, from a ruleset."""
    opened = os.open(path, os.O_PATH | os.O_CLOEXEC)
    try:
        system_call(_ADD_RULE, ruleset, _BENEATH, struct.pack("=Qi", access, opened), 0)
    finally:
        os.close(opened)
