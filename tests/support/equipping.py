"""What stands for the code of a device in a sandbox: `equip` for each job, and an entry that says what it got."""

from typing import Any

from tacevo.sandbox.child import Arrays, Send


def equip(header: Any, payload: bytes, arrays: Arrays) -> Arrays:
    """Read a file, which no confined process can, and fail where the job says so."""
    if header == "fail":
        raise RuntimeError("CUDA error: out of memory")
    with open("/proc/self/status", encoding="utf-8") as file:
        return {**arrays, "status": file.readline().split()[0]}


def tell(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Report the arrays that are no files, and whether a file can be read."""
    try:
        open("/proc/self/status", encoding="utf-8").close()
        is_confined = False
    except OSError:
        is_confined = True
    send([arrays.get("status"), is_confined], b"")
