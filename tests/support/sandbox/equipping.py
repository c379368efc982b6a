"""What stands for the code of a device in a sandbox: `equip` for each job, and an entry that says what it got."""

import time
from typing import Any

import attacks

from tacevo.sandbox.child import Arrays, Send


def equip(header: Any, payload: bytes, arrays: Arrays) -> Arrays:
    """Read a file, which no confined process can; fail, sleep or take memory first where the job says so."""
    if header == "fail":
        raise RuntimeError("CUDA error: out of memory")
    if isinstance(header, dict):
        time.sleep(header.get("seconds", 0.0))
        taken = bytearray(b"1") * (header.get("mib", 0) * 2**20)
        del taken  # the peak counts, even where nobody saw it
    with open("/proc/self/status", encoding="utf-8") as file:
        return {**arrays, "status": file.readline().split()[0]}


def tell(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Report the arrays that are not files, and whether a file can be read."""
    try:
        open("/proc/self/status", encoding="utf-8").close()
        is_confined = False
    except OSError:
        is_confined = True
    send([arrays.get("status"), is_confined], b"")


def rest(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Sleep as long as `equip` did."""
    time.sleep(header["seconds"])


def stop_supervisor_later(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Stop the parent when it has noticed that the candidate runs."""
    time.sleep(0.5)
    attacks.stop_supervisor(header, payload, arrays, send)
