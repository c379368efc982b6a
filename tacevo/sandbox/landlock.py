"""Landlock (landlock(7)): the process gives up the file system, the network and signals to others, for good.

A ruleset names kinds of access that are refused from then on, except where a rule allows them. A candidate needs no
access, so there is no rule. Only `no_new_privs` must be set. Files that were open before stay open.
"""

import os
import struct

from tacevo.sandbox.kernel import system_call

# The same on every architecture, like every call that is as young.
_CREATE_RULESET = 444
_RESTRICT_SELF = 446
_ASK_VERSION = 1
#: How many kinds of file access each version of the interface knows; later ones know as many as the last.
_FILE_ACCESSES = {1: 13, 2: 14, 3: 15, 4: 15, 5: 16}
#: The first version that knows: TCP bind and connect; abstract Unix sockets and signals of others.
NETWORK_SINCE, SCOPES_SINCE = 4, 6
_BIND_AND_CONNECT = 0b11
_SOCKETS_AND_SIGNALS = 0b11


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


def restrict() -> None:
    """Take from this thread, and from all that it starts, everything that Landlock can refuse.

    It opens a file for a moment, so it comes before a limit on open files.

    Raises:
        OSError: Landlock is missing, or `no_new_privs` is not set.
    """
    ruleset = struct.pack("=QQQ", *refused(version()))  # a kernel accepts last fields that it does not know as 0
    descriptor = system_call(_CREATE_RULESET, ruleset, len(ruleset), 0)
    try:
        system_call(_RESTRICT_SELF, descriptor, 0)
    finally:
        os.close(descriptor)
