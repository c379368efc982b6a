"""The sandbox as the search sees it: one call runs one candidate's job in a confined process of its own.

What it promises: the answer is data (JSON and raw bytes of stated length), however the candidate behaves; when a
call returns, or the search ends for any reason, no process of the candidate is left; a candidate over a limit is
dead within a second. docs/security.md says what it does not promise.
"""

from __future__ import annotations

import contextlib
import math
import re
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Protocol, Self, TypeVar

from tacevo.choices import Confinement
from tacevo.errors import SandboxError, TacevoError
from tacevo.records import Json, Limits, Reason, to_json
from tacevo.sandbox import boot
from tacevo.sandbox.confinement import check_confinement
from tacevo.sandbox.kernel import protect_memory
from tacevo.sandbox.processes import end_tree
from tacevo.sandbox.protocol import CHILD, Channel, Header, Message, Sort, describe, one_line
from tacevo.typed import convert

#: Seconds that a zygote may take to import torch, and a supervisor to start on a busy machine.
_START_SECONDS = 120.0
#: Seconds after a candidate's limit at which the search itself kills it: the candidate stopped its supervisor.
_GRACE_SECONDS = 5.0
#: Seconds that a supervisor may take to pass an answer on, when the candidate is gone.
_TRANSFER_SECONDS = 20.0
_AGAIN = "run the same command again"
#: The modules that torch imports when they are first needed. It takes as long as torch itself, and few candidates need
#: it.
_LATE_IMPORTS = ("torch._dynamo",)
#: Called with the measures in force for a candidate, as `tacevo.sandbox.confinement.confine` names them.
Notice = Callable[[tuple[str, ...]], None]

T = TypeVar("T")


class AnswerError(TacevoError):
    """A child's answer is not what its entry sends; the caller makes it a verdict on the candidate."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One part of an answer; nothing in it is trusted."""

    header: Json
    payload: bytes

    def read(self, kind: type[T]) -> T:
        """Read the header as a record.

        Raises:
            AnswerError: it is not such a record.
        """
        return convert(kind, self.header, place="", error=AnswerError)


@dataclass(frozen=True, slots=True)
class Finished:
    """The entry returned, after it had sent these frames."""

    frames: tuple[Frame, ...]
    #: Processor time of the candidate and its supervisor, as the latter read it outside the candidate's process.
    cpu_seconds: float = field(default=0.0, compare=False)


@dataclass(frozen=True, slots=True)
class Died:
    """The candidate was killed at a limit (`out_of_time`, `out_of_memory`) or ended without an answer (`crashed`)."""

    reason: Reason
    #: One line for a person.
    detail: str
    #: The processor time, as of `Finished`; 0 where the supervisor could not tell.
    cpu_seconds: float = field(default=0.0, compare=False)


#: Scores a frame, by its number from 0 and its payload, the lower the better, and raises nothing. For a node it is
#: pickled. A candidate may send what frames it likes, so one that is not expected gets infinity and tells it nothing.
Score = Callable[[int, bytes], float]


class RunJob(Protocol):
    """Runs a job, as `Sandbox.run` does."""

    def __call__(
        self, entry: str, header: Json, payload: bytes, limits: Limits, score: Score | None = None, /
    ) -> Finished | Died:
        """Run a job and wait for it."""


@dataclass(frozen=True, slots=True)
class _Killed:
    """The candidate or its supervisor was killed, by the candidate or from outside."""

    detail: str


class _LostError(SandboxError):
    """A job was lost before any code of the candidate ran."""


class _StartError(SandboxError):
    """A zygote did not start."""


class _UnpreparedError(SandboxError):
    """A job's process tried to import a module that its zygote has not imported."""


class Sandbox:
    """Runs jobs, each in a fresh fork of one prepared process; several threads may call `run` at once.

    The prepared process (the zygote) starts with the first job, unless one was started before. If it dies, the
    supervisors finish the running jobs, and the next job starts another zygote. A job that needs a module which the
    zygote has not imported runs again, from its beginning, below a second zygote that has imported more; the two do not
    differ otherwise.

    Args:
        entries: name to `module:function`; see `tacevo.sandbox.child.Entry`.
        environment: the whole environment of the candidates, except for a fixed `PYTHONHASHSEED`.
        arrays: name to an `.npy` file, mapped read-only for the entries.
        strongest: measures above this level are left out, so that tests run as on a weaker machine.
        doors: by the name of an entry, patterns of device files that its jobs may open behind all walls, for the
            driver that `equip` starts; jobs of others may open none.
        notice: called for every candidate before its answer is returned, by the thread that waits for it.
        zygote: one that was started with these entries, this environment and `equip`; the sandbox ends it.
        equip: `module:function` of what gets a device ready for each job; see `tacevo.sandbox.child.Equip`.
        answer_bytes: the most that a job may answer.
    """

    def __init__(
        self,
        *,
        entries: Mapping[str, str],
        environment: Mapping[str, str],
        arrays: Mapping[str, Path],
        strongest: Confinement = Confinement.kernel,
        doors: Mapping[str, Sequence[str]] | None = None,
        notice: Notice | None = None,
        zygote: Zygote | None = None,
        equip: str | None = None,
        answer_bytes: int = CHILD.total_bytes,
    ) -> None:
        check_confinement(Confinement.process)
        protect_memory()  # labels and keys are in this process's memory, and candidates run under the same user
        self._entries, self._environment, self._arrays = entries, environment, arrays
        self._strongest, self._doors, self._equip = strongest, doors or {}, equip
        self._notice, self._answer_bytes = notice, answer_bytes
        self._lock = threading.Lock()
        #: The zygotes, by whether they have all imports.
        self._zygotes: dict[bool, Zygote] = {} if zygote is None else {False: zygote}
        self._closed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def run(
        self, entry: str, header: Json, payload: bytes, limits: Limits, score: Score | None = None
    ) -> Finished | Died:
        """Run one job and wait for it.

        A job that was killed, or lost its supervisor, runs once more; the second time counts as the candidate's doing.
        With `score` each frame is scored here as it comes, and the job is told whether its score is the lowest so far,
        and nothing else. The time that this takes is not the candidate's, but for what it computes meanwhile.

        Raises:
            SandboxError: the sandbox itself failed; this says nothing about the candidate.
            KeyError: it is not an entry of the sandbox.
        """
        if entry not in self._entries:
            raise KeyError(f"expected one of the entries {sorted(self._entries)}; got {entry!r}")
        order: dict[str, Json] = {"entry": entry, "header": header, "limits": to_json(limits)}
        order |= {"strongest": self._strongest, "doors": list(self._doors.get(entry, ()))}
        order |= {"answer_bytes": self._answer_bytes, "scored": score is not None}
        try:
            return self._run(order, payload, limits, score, prepared=False)
        except _UnpreparedError:
            return self._run(order, payload, limits, score, prepared=True)

    def _run(
        self, order: Mapping[str, Json], payload: bytes, limits: Limits, score: Score | None, *, prepared: bool
    ) -> Finished | Died:
        """Run a job, once more where it was killed, and each time once more where it was lost."""
        job = Message.of(Sort.job, {**order, "prepared": prepared}, payload)
        for _ in range(2):  # a kill by the kernel or a person is rare; a candidate that did it will do it again
            try:
                answer = self._attempt(job, limits, score, prepared)
            except _LostError:
                answer = self._attempt(job, limits, score, prepared)
            if not isinstance(answer, _Killed):
                return answer
            if self._closed:
                raise SandboxError("the sandbox was closed while a candidate ran", remedy=_AGAIN)
            detail = answer.detail
        return Died(Reason.crashed, detail)

    def _attempt(self, job: Message, limits: Limits, score: Score | None, prepared: bool) -> Finished | Died | _Killed:
        """Run a job in a fresh process."""
        ours, theirs = socket.socketpair()
        with ours:
            with theirs:
                self._submit(theirs, prepared)
            channel = Channel(ours)
            supervisor = _hand_over(channel, job)
            equips = self._equip is not None
            return _await_answer(channel, limits, supervisor, self._notice, score, equips=equips)

    def close(self) -> None:
        """End the zygotes and every job; calls to `run` that wait in other threads raise `SandboxError`."""
        with self._lock:
            self._closed = True
            while self._zygotes:
                self._zygotes.popitem()[1].close()

    def _submit(self, job: socket.socket, prepared: bool) -> None:
        """Pass the socket of a job to its zygote, starting one where there is none."""
        with self._lock:
            if self._closed:
                raise SandboxError("the sandbox is closed", remedy="open another one")
            if prepared in self._zygotes:
                with contextlib.suppress(_LostError):  # it is dying, which may not show yet
                    self._submit_to(prepared, job)
                    return
            imports = _LATE_IMPORTS if prepared else ()
            self._zygotes[prepared] = Zygote(self._entries, self._environment, imports=imports, equip=self._equip)
            self._submit_to(prepared, job)

    def _submit_to(self, prepared: bool, job: socket.socket) -> None:
        """Pass the socket of a job to a zygote; one that cannot is ended, so that the next job starts another."""
        try:
            self._zygotes[prepared].submit(job, self._arrays)
        except (_LostError, _StartError):
            self._zygotes.pop(prepared).close()
            raise


class Zygote:
    """A process that imports the entries, and with them torch, while its maker does other things, and then takes jobs.

    `imports` are modules beside those that the entries need; the rest is as of `Sandbox`.
    """

    def __init__(
        self,
        entries: Mapping[str, str],
        environment: Mapping[str, str],
        *,
        imports: Sequence[str] = (),
        equip: str | None = None,
    ) -> None:
        self._stream, theirs = socket.socketpair()
        #: The file for what the process writes until it has started; unlike a pipe it cannot fill up and block it.
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `close`, or when it has started
        self._has_started = False
        with theirs:
            self._process = subprocess.Popen(
                boot.command(theirs.fileno()),
                env={**environment, "PYTHONHASHSEED": "0"},
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self._errors,
                start_new_session=True,  # Ctrl-C is the search's to handle
            )
        with contextlib.suppress(OSError):  # who waits for its start is told that it died
            setup = {"entries": dict(entries), "imports": list(imports), "equip": equip}
            Channel(self._stream).send(Message.of(Sort.setup, setup))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _await_start(self, arrays: Mapping[str, Path]) -> None:
        """Have the arrays mapped, and wait until jobs can be taken."""
        channel = Channel(self._stream)
        self._stream.settimeout(_START_SECONDS)
        try:
            channel.send(Message.of(Sort.arrays, {name: str(Path(p).resolve()) for name, p in arrays.items()}))
            problem = channel.receive().read_header()["error"]
        except (OSError, EOFError) as error:
            said = _last_line(self._errors) or "nothing"
            raise _StartError(f"{describe(error)}; it wrote: {said}", expected="a zygote that starts") from error
        if problem is not None:
            if lacking := re.search(r"No module named '(\w+)", problem):
                expected = f"{lacking[1]}, which the processes of the sandbox import"
                remedy = (
                    f"install {lacking[1]} (docs/installation.md): an environment of make check-only trains nothing"
                )
                raise _StartError(problem, expected=expected, remedy=remedy)
            raise _StartError(problem, expected="a zygote that imports its entries and maps its arrays")
        self._errors.close()
        self._has_started = True

    def submit(self, job: socket.socket, arrays: Mapping[str, Path]) -> None:
        """Pass on the socket of a job; the first one waits for the start, and has the arrays mapped for all.

        Raises:
            _LostError: the zygote is gone.
            SandboxError: it did not start; or the kernel does not pass the socket on at the moment, and the zygote and
                its jobs continue.
        """
        if not self._has_started:
            self._await_start(arrays)
        try:
            socket.send_fds(self._stream, [b"j"], [job.fileno()])
        except (BrokenPipeError, ConnectionResetError) as error:
            raise _LostError(str(error), expected="a zygote that takes jobs", remedy=_AGAIN) from error
        except OSError as error:
            raise SandboxError(str(error), expected="a kernel that passes jobs on", remedy=_AGAIN) from error

    def close(self) -> None:
        """End the process and everything below it; harmless when it has ended already."""
        self._stream.close()  # its end of file is the order to end everything
        self._errors.close()
        if not self._has_started:  # it has no jobs to end, and would not see the end of file before torch is imported
            self._process.kill()
        try:
            self._process.wait(_GRACE_SECONDS)
        except subprocess.TimeoutExpired:
            end_tree(self._process.pid)
            self._process.wait()


def _last_line(errors: IO[bytes]) -> str:
    """Return the last line of a file that is not blank; empty where there is none."""
    errors.seek(0)
    lines = [line for line in errors.read().decode(errors="replace").splitlines() if line.strip()]
    return one_line(lines[-1]) if lines else ""


def _hand_over(channel: Channel, job: Message) -> int:
    """Send the job to its supervisor, before any code of the candidate runs; return the supervisor's process id."""
    channel.stream.settimeout(_START_SECONDS)
    try:
        supervisor: int = channel.receive().read_header()["pid"]
        channel.send(job)
    except (OSError, EOFError) as error:
        raise _LostError(describe(error), expected="a supervisor for the job", remedy=_AGAIN) from error
    return supervisor


def _await_answer(
    channel: Channel, limits: Limits, supervisor: int, notice: Notice | None, score: Score | None, *, equips: bool
) -> Finished | Died | _Killed:
    """Collect the frames and the verdict of one job; `equips` says whether a device is made ready for it first."""
    frames, lowest = [], math.inf
    longest = limits.seconds + _GRACE_SECONDS
    try:
        message = channel.receive(time.monotonic() + longest)
        if message.sort is Sort.ready:
            equips = False  # from here on, the time is the candidate's
            message = channel.receive(time.monotonic() + longest)
        deadline = time.monotonic() + _TRANSFER_SECONDS
        while message.sort is Sort.frame:
            frames.append(message)
            if score is not None:
                value = score(len(frames) - 1, message.payload)
                with contextlib.suppress(OSError):  # the candidate has ended meanwhile; how is still to be read
                    channel.send(Message.of(Sort.scored, value < lowest))
                lowest = min(lowest, value)
                deadline = time.monotonic() + longest  # the candidate goes on
            message = channel.receive(deadline)
    except TimeoutError:
        end_tree(supervisor)
        if equips:
            got, expected = f"none after {longest:g} s", "a device that is ready for a job"
            raise SandboxError(got, expected=expected, remedy=_AGAIN) from None
        return Died(Reason.out_of_time, f"ran for more than {limits.seconds:g} s, and its supervisor was stopped")
    except (OSError, EOFError):
        return _Killed("its supervisor was killed")
    verdict = message.read_header()
    measures = verdict.get("measures")  # None where the sandbox broke before
    if notice is not None and measures is not None:
        notice(tuple(measures))
    return _judge(verdict, frames)


def _judge(verdict: Header, messages: list[Message]) -> Finished | Died | _Killed:
    """Return what the supervisor's verdict and the candidate's frames, which may be garbage, mean."""
    match verdict["ended"]:
        case "finished":
            try:
                frames = tuple(Frame(message.read_header(), message.payload) for message in messages)
                return Finished(frames, verdict["cpu"])
            except ValueError as error:
                return Died(Reason.crashed, one_line(f"a header of its answer cannot be read: {error}"))
        case "died":
            return Died(Reason(verdict["reason"]), one_line(verdict["detail"]), verdict["cpu"])
        case "unprepared":
            raise _UnpreparedError("a job needs a module that the zygote has not imported")
        case "killed":
            return _Killed(verdict["detail"])
        case "lost":
            raise _LostError(verdict["detail"], expected="a child that is confined", remedy=_AGAIN)
        case _:
            raise SandboxError(one_line(verdict["detail"]), expected="a sandbox that works")
