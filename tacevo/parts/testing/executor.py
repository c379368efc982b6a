"""The promises of an executor: wherever candidates run, their answers are those of this machine."""

import hashlib
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from tacevo.choices import Confinement, Device, Numerics
from tacevo.parts.executor import Order
from tacevo.parts.testing.contract import Contract, require
from tacevo.records import Json, Limits
from tacevo.sandbox.child import Arrays, Send
from tacevo.sandbox.client import Died, Finished, RunJob, Sandbox
from tacevo.sandbox.protocol import Header

_ENTRIES = {"answer": "tacevo.parts.testing.executor:answer", "die": "tacevo.parts.testing.executor:die"}

_LIMITS = Limits(seconds=20.0, memory_mib=512)

_JOBS = 4

#: NumPy, which the kit imports, would start threads in the process that forks.
_ENVIRONMENT = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def executor_contracts(executor: Any) -> list[Contract]:
    """List what an executor promises."""

    def runs_as_here() -> None:
        """Several jobs at once have the frames that a sandbox of this machine gives."""
        with Sandbox(entries=_ENTRIES, environment=_ENVIRONMENT, arrays={}) as sandbox:
            expected = [_job(sandbox.run, number) for number in range(_JOBS)]
        with (
            executor.ahead(_order()) as started,
            executor.open(_order(), None, started=started) as run,
            ThreadPoolExecutor(_JOBS) as pool,
        ):
            found = list(pool.map(lambda number: _job(run, number), range(_JOBS)))
        require(found == expected, f"{expected}, as a sandbox of this machine answers", found)

    def tells_a_death() -> None:
        """A candidate that dies is told as such, and the next one runs."""
        with executor.open(_order(), None) as run:
            died = run("die", {}, b"", _LIMITS)
            require(isinstance(died, Died), "a candidate that ends itself to have died", died)
            _job(run, 0)

    def notices() -> None:
        """The executor tells what confined a candidate before its answer is used."""
        noticed: list[object] = []
        with executor.open(_order(), None, notice=noticed.append) as run:
            _job(run, 0)
        require(bool(noticed), "a call of `notice` for every candidate", noticed)

    return [
        Contract("accepts an order that this machine can fulfil", lambda: executor.check(_order())),
        Contract("runs several jobs at once, with the answers of a sandbox of this machine", runs_as_here),
        Contract("says of a candidate that it died, and runs the next", tells_a_death),
        Contract("calls `notice` before an answer is used", notices),
    ]


def _order() -> Order:
    return Order(
        entries=_ENTRIES,
        equip=None,
        environment=_ENVIRONMENT,
        numerics=Numerics.portable,
        device=Device.cpu,
        gpu=None,
        per_gpu=None,
        require=Confinement.process,
    )


def _job(run: RunJob, number: int) -> list[Json]:
    outcome = run("answer", {"number": number}, bytes([number]) * 1000, _LIMITS)
    require(isinstance(outcome, Finished), "a job that ends", outcome)
    assert isinstance(outcome, Finished)
    return [[frame.header, hashlib.sha256(frame.payload).hexdigest()] for frame in outcome.frames]


def answer(header: Header, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Send two frames that follow from the job."""
    send({"number": header["number"], "first": True}, payload)
    send({"number": header["number"], "first": False}, hashlib.sha256(payload).digest())


def die(header: Header, payload: bytes, arrays: Arrays, send: Send) -> None:
    """End without an answer."""
    import os

    os._exit(3)
