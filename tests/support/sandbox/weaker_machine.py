"""Makes this process, and all that it starts, see a kernel without Landlock, as in a container that hides it."""

import ctypes
import errno
import platform
import struct

from tacevo.sandbox.kernel import renounce_privileges, system_call
from tacevo.sandbox.seccomp import MACHINES

_CREATE_RULESET = 444
_SET_FILTER = 1


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("text", ctypes.c_char_p))


def lose_landlock() -> None:
    """Have the kernel answer that it knows no Landlock, for good."""
    instructions = (
        (0x20, 0, 0, 0),  # load the number of the call
        (0x15, 0, 1, _CREATE_RULESET),  # if it is this one,
        (0x06, 0, 0, 0x00050000 | errno.ENOSYS),  # it is unknown;
        (0x06, 0, 0, 0x7FFF0000),  # all others pass
    )
    text = b"".join(struct.pack("=HBBI", *instruction) for instruction in instructions)
    renounce_privileges()
    system_call(MACHINES[platform.machine()].seccomp, _SET_FILTER, 0, ctypes.byref(_Program(len(instructions), text)))
