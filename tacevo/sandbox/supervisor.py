"""One trusted process for each candidate: starts it, watches time and memory, kills its tree, passes the answer on.

It never runs a line of the candidate. The only header of the child that it parses is the first, which the child sends
before any such line runs.
"""

import contextlib
import mmap
import os
import select
import signal
import socket
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import replace

from tacevo.records import Json, Limits, Reason
from tacevo.sandbox import child
from tacevo.sandbox.kernel import become_subreaper
from tacevo.sandbox.processes import cpu_seconds, descendants, end_own_descendants, is_ending, lies_in_memory, memory
from tacevo.sandbox.protocol import CHILD, Bounds, Channel, Message, Sort, Splitter, TooMuchError, describe, one_line

_TICK = 0.025  # seconds between two checks of time and memory
_PIPE_SIZE = 2**20  # bytes; the most that an unprivileged process can make a pipe hold
_LONGEST_REASON = 2**16  # bytes that are read of a child's last message, of which `one_line` keeps fewer


def supervise(
    search: socket.socket, entries: Mapping[str, child.Entry], arrays: child.Arrays, equip: child.Equip | None
) -> None:
    """Serve one job that comes over `search`, and leave no process behind.

    Raises:
        OSError: the search is gone, noticed while writing.
    """
    channel = Channel(search)
    try:
        become_subreaper()
        channel.send(Message.of(Sort.hello, {"pid": os.getpid()}))
        answer = _serve(channel, entries, arrays, equip)
    except EOFError:
        return  # the search no longer waits
    except Exception as error:
        answer = [Message.of(Sort.verdict, {"ended": "broken", "detail": describe(error)}).to_bytes()]
    finally:
        end_own_descendants()
    for part in answer:
        search.sendall(part)


def _serve(
    channel: Channel, entries: Mapping[str, child.Entry], arrays: child.Arrays, equip: child.Equip | None
) -> list[bytes | memoryview]:
    """Start the candidate and watch it until it ends; return what is left to be sent: its frames and the verdict.

    Raises:
        EOFError: the search has given the job up, or is gone.
    """
    message = channel.receive()
    job = message.read_header()
    bounds = replace(CHILD, total_bytes=job["answer_bytes"])
    told = mmap.mmap(-1, bounds.messages) if job["scored"] else None
    pipe, theirs = os.pipe()
    supervisor = os.getpid()
    pid = os.fork()
    if pid == 0:
        entry = entries[job["entry"]]
        child.run(entry, job, message.payload, arrays, theirs, supervisor=supervisor, equip=equip, told=told)
    os.close(theirs)
    os.set_blocking(pipe, False)
    limits = Limits(**job["limits"])
    watch = _Watch(
        pid,
        pipe,
        channel,
        limits,
        bounds,
        prepared=job["prepared"],
        equips=equip is not None,
        told=told,
        mapped_mib=sum(array.nbytes for array in arrays.values() if lies_in_memory(array.filename)) / 2**20,
    )
    verdict = watch.until_the_end()
    # Measured here, where the candidate cannot reach. What is reaped already counts as this process's children.
    cpu = sum(map(cpu_seconds, (supervisor, *descendants(supervisor))))
    last = Message.of(Sort.verdict, {**verdict, "measures": watch.measures, "cpu": cpu})
    return [watch.unsent, *(message.to_bytes() for message in (*watch.frames, last))]


class _Watch:
    """A candidate under watch: the state of a child, and the end of its result pipe, which must not block.

    When the channel to the search closes, the search no longer waits. `told` and `prepared` are as in `child.run`,
    `mapped_mib` is what those arrays take that lie in memory. Where the child `equips` itself first, that has the
    limits too; the candidate's time begins afterwards, and the search is told so.
    """

    def __init__(
        self,
        pid: int,
        pipe: int,
        channel: Channel,
        limits: Limits,
        bounds: Bounds,
        *,
        prepared: bool,
        equips: bool,
        told: mmap.mmap | None,
        mapped_mib: float,
    ) -> None:
        self.frames: list[Message] = []
        #: The rest of the frame that the search is to score, still to be sent.
        self.unsent = memoryview(b"")
        #: The measures that `confine` put in force; None before, when no code of the candidate has run.
        self.measures: Json = None
        self._pid, self._pipe, self._channel, self._limits = pid, pipe, channel, limits
        self._told, self._scored = told, 0
        self._unscored: deque[Message] = deque()  # the search has the first of them, or a part of it
        self._asked = 0.0, 0.0  # when there was none before, by clock and processor time
        self._cpu: dict[int, float] = {}  # process id -> most processor time seen so far
        self._prepared, self._equips = prepared, equips
        self._search = channel.stream.fileno()
        self._end = os.pidfd_open(pid)
        self._deadline = time.monotonic() + limits.seconds
        self._mapped_mib = mapped_mib
        self._inherited_mib = memory(os.getpid(), mapped_mib).anonymous
        self._files_mib: dict[int, float] = {}  # process id -> most memory of mapped files seen so far
        self._splitter = Splitter(bounds)
        self._poll = select.poll()
        for descriptor, event in ((pipe, select.POLLIN), (self._end, select.POLLIN), (self._search, select.POLLRDHUP)):
            self._poll.register(descriptor, event)

    def until_the_end(self) -> dict[str, Json]:
        """Wait until the candidate is done, dead or over a limit; return the verdict."""
        ended: dict[str, Json] | None = None
        while ended is None or (ended["ended"] == "finished" and self._unscored):
            if time.monotonic() >= self._deadline + self._paused():
                return self._over(Reason.out_of_time, f"ran for more than {self._limits.seconds:g} s")
            if self._has_too_much_memory():
                return self._out_of_memory()
            happened = dict(self._poll.poll(_TICK * 1000))
            if self._search in happened:
                self._converse(happened[self._search])
            if ended is None:
                ended = self._read()
                if ended is None and self._end in happened:
                    ended = self._read() or self._lost()  # what it wrote before it died still counts
                if ended is not None:
                    self._ignore(self._pipe, self._end)
        is_over = ended["ended"] == "finished" and self._has_too_much_memory()
        return self._out_of_memory() if is_over else ended

    def _read(self) -> dict[str, Json] | None:
        """Read what is in the pipe; return the verdict if it ends the job."""
        try:
            data = os.read(self._pipe, _PIPE_SIZE)
            messages = self._splitter.feed(data)
        except BlockingIOError:
            return None
        except TooMuchError as error:
            return _died(Reason.too_much_output, str(error))
        except ValueError as error:
            return _died(Reason.crashed, f"its answer cannot be read: {error}")
        for message in messages:
            verdict = self._hear(message)
            if verdict is not None:
                return verdict
        return None if data else self._lost()  # no data: every writer has closed the pipe

    def _hear(self, message: Message) -> dict[str, Json] | None:
        """Take one message of the child; return the verdict if it is the last."""
        match message.sort:
            case Sort.ready if self.measures is None:
                return self._begin(message)
            case Sort.frame if self._told is None:
                self.frames.append(message)
            case Sort.frame:
                self._have_scored(message)
            case Sort.done:
                return {"ended": "finished"}
            case Sort.unprepared if not self._prepared:
                return {"ended": "unprepared"}
            case Sort.starved | Sort.raised:
                return self._failed(message)
            case _:
                return _died(Reason.crashed, f"it sent a message of sort {message.sort.name}")
        return None

    def _begin(self, ready: Message) -> dict[str, Json] | None:
        """Note that the candidate runs from now on; return the verdict if what came before was over a limit."""
        if self._equips:
            if self._has_too_much_memory():  # the peak of what came before counts in every later check
                return self._out_of_memory()
            self._deadline = time.monotonic() + self._limits.seconds
            self._channel.send(ready)
        self.measures = ready.read_header()
        return None

    def _have_scored(self, frame: Message) -> None:
        """Have the search score a frame, after those that came before; nothing here waits for it."""
        self._unscored.append(frame)
        if len(self._unscored) == 1:
            self._asked = time.monotonic(), self._cpu_seconds()
            self._ask()

    def _ask(self) -> None:
        """Begin to send the next frame to the search, which reads when it can."""
        self.unsent = memoryview(self._unscored[0].to_bytes())
        self._poll.modify(self._search, select.POLLRDHUP | select.POLLOUT)

    def _converse(self, events: int) -> None:
        """Send the search as much of a frame as it takes now, or tell the child what it says of one.

        Raises:
            EOFError: the search is gone.
        """
        if events & ~(select.POLLIN | select.POLLOUT):
            raise EOFError("the search has given the job up")
        if events & select.POLLOUT:
            self.unsent = self.unsent[self._channel.stream.send(self.unsent, socket.MSG_DONTWAIT) :]
            if not self.unsent:
                self._poll.modify(self._search, select.POLLRDHUP | select.POLLIN)
            return
        assert self._told is not None
        self._told[self._scored] = child.LOWEST if self._channel.receive().read_header() else child.NOT_LOWEST
        self._scored += 1
        paused = self._paused()
        self._unscored.popleft()
        if self._unscored:
            self._ask()
        else:
            self._deadline += paused
            self._poll.modify(self._search, select.POLLRDHUP)

    def _paused(self) -> float:
        """Return for how long its time has stood still: since frames are scored, but for its processor time since."""
        if not self._unscored:
            return 0.0
        since, before = self._asked
        return max(0.0, time.monotonic() - since - (self._cpu_seconds() - before))

    def _cpu_seconds(self) -> float:
        """Return the processor time of all that ran below, as last seen: one that is gone takes none of its away."""
        for pid in descendants(os.getpid()):
            self._cpu[pid] = max(self._cpu.get(pid, 0.0), cpu_seconds(pid))
        return sum(self._cpu.values())

    def _ignore(self, *descriptors: int) -> None:
        """Look at files no longer, which would wake the poll at once, again and again."""
        for descriptor in descriptors:
            with contextlib.suppress(KeyError):  # it was done before
                self._poll.unregister(descriptor)

    def _failed(self, message: Message) -> dict[str, Json]:
        """Return the verdict on a child that raised, or was refused memory."""
        if self.measures is None:
            return {"ended": "broken", "detail": f"a child could not be equipped or confined: {_last_words(message)}"}
        reason = Reason.out_of_memory if message.sort is Sort.starved else Reason.crashed
        return _died(reason, _last_words(message))

    def _lost(self) -> dict[str, Json] | None:
        """Return the verdict on a child that closed its pipe before it was done; None while it is still exiting."""
        end = os.waitid(os.P_PID, self._pid, os.WEXITED | os.WNOHANG)
        # A process closes its files before it can be waited for, sometimes long before.
        if end is None and is_ending(self._pid):
            self._ignore(self._pipe)
            return None
        if end is None or end.si_code == os.CLD_TRAPPED:  # it is alive, and made this process its tracer
            how = "it closed its result pipe"
        elif end.si_code == os.CLD_EXITED:
            how = f"it exited with status {end.si_status} before it had answered"
        else:
            how = f"killed by signal {end.si_status}"
            if end.si_status == signal.SIGKILL:  # not sent from here
                return {"ended": "killed" if self.measures is not None else "lost", "detail": how}
        return {"ended": "broken", "detail": how} if self.measures is None else _died(Reason.crashed, how)

    def _has_too_much_memory(self) -> bool:
        """Return whether the whole tree has, or briefly had, more memory than allowed, without what it inherited."""
        used = sum(max(0.0, self._peak_mib(pid) - self._inherited_mib) for pid in descendants(os.getpid()))
        return used > self._limits.memory_mib

    def _peak_mib(self, pid: int) -> float:
        """Return the most memory not backed by files that a process ever held, in MiB, or a little less.

        The kernel records the peak of all memory. The limit does not count mapped files; at the peak they took at most
        what this process has seen them take.
        """
        seen = memory(pid, self._mapped_mib)
        self._files_mib[pid] = max(seen.of_files, self._files_mib.get(pid, 0.0))
        return max(seen.anonymous, seen.peak - self._files_mib[pid])

    def _out_of_memory(self) -> dict[str, Json]:
        return self._over(Reason.out_of_memory, f"used more than {self._limits.memory_mib} MiB of resident memory")

    def _over(self, reason: Reason, detail: str) -> dict[str, Json]:
        """Return the verdict on a child over a limit: on the candidate, unless its device was still made ready."""
        if self._equips and self.measures is None:
            return {"ended": "broken", "detail": f"what makes a device ready {detail}"}
        return _died(reason, detail)


def _last_words(message: Message) -> str:
    """Read the child's own reason for its end."""
    return one_line(message.payload[:_LONGEST_REASON].decode(errors="replace"))


def _died(reason: Reason, detail: str) -> dict[str, Json]:
    return {"ended": "died", "reason": reason.value, "detail": detail}
