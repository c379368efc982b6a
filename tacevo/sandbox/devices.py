"""The doors that a candidate on an NVIDIA GPU keeps and others lose: device files, and the calls of their driver.

Of the driver only the kernel's half is open source; what its library calls is not documented. The lists below are from
the headers of NVIDIA's open kernel modules and from gVisor's nvproxy, which forwards the same commands for sandboxed
programs. Nobody has run them here on a GPU: a small computation tries them before the first candidate
(`tacevo.training.gpu.look`), and a run stops where it fails.
"""

import os
import sys
from collections.abc import Iterable
from glob import glob

#: The driver's device files: its control, memory that is shared with the host, each GPU, and parts of one (MIG). Not
#: those of displays, debuggers and profilers.
DEVICES = ("/dev/nvidiactl", "/dev/nvidia-uvm", "/dev/nvidia[0-9]*", "/dev/nvidia-caps/*")
#: The directories and files that the driver's library may read when it starts, before any code of a candidate runs:
#: libraries, what the kernel says of devices, processors and memory, and settings.
_READABLE = ("/usr", "/lib", "/lib64", "/opt", "/etc", "/proc", "/sys")

#: Commands of /dev/nvidiactl and /dev/nvidia0: type F, by number (nv-ioctl-numbers.h, nv_escape.h). Left out are those
#: that give memory to another process or a network card.
_FRONTEND_TYPE = ord("F") << 8
_FRONTEND = (
    *(200 + number for number in (0, 1, 6, 7, 10, 12, 14, 15, 18)),  # cards, files, events, versions, memory
    *(0x27, 0x29, 0x2A, 0x2B, 0x34, 0x35),  # objects: memory, free, control, allocate, duplicate, share
    *(0x4A, 0x4E, 0x4F, 0x5E),  # heap, map, unmap, where something is mapped
)
#: Commands of /dev/nvidia-uvm (uvm_ioctl.h, uvm_linux_ioctl.h). Left out are those of debuggers and profilers, which
#: read and write the memory of processes.
UVM_COMMANDS = (
    *(0x30000001, 0x30000002),  # begin and end
    *(23, 24, 25, 26, 27, 28, 29, 30, 31),  # groups of ranges, address spaces, channels, peers
    *(33, 34, 37, 38, 39),  # external memory, free, GPUs, pageable memory
    *(42, 43, 45, 47, 51, 53),  # where memory lies, and its way from place to place
    *(65, 66, 68, 72, 73, 75),  # regions, semaphores, ranges, address spaces of processes
)
#: The commands by their low 16 bits; above them stands the size of what is passed, which differs from driver to driver.
FRONTEND_COMMANDS = tuple(_FRONTEND_TYPE | number for number in _FRONTEND)


def present(patterns: Iterable[str]) -> list[str]:
    """List the device files of this machine, in order."""
    return sorted({path for pattern in patterns for path in glob(pattern)})


def readable() -> list[str]:
    """List the directories that the driver's library may read, with those of this Python and of torch.

    Not the rest of Python's path: a clone of this project may lie there, with its stores and data.
    """
    packages = [path for path in sys.path if os.path.isdir(os.path.join(path, "torch"))]
    own = map(os.path.abspath, (sys.prefix, sys.base_prefix, *packages))
    return [path for path in dict.fromkeys((*_READABLE, *own)) if os.path.isdir(path)]
