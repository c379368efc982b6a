"""The candidate's process: confined first, then the entry, then the end."""

import itertools
import mmap
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from importlib.machinery import BuiltinImporter, FrozenImporter
from types import SimpleNamespace
from typing import Any, NoReturn

from tacevo.choices import Confinement
from tacevo.records import Json, Limits
from tacevo.sandbox.confinement import confine, shut_out
from tacevo.sandbox.devices import present
from tacevo.sandbox.kernel import end_with, keep_priority
from tacevo.sandbox.processes import close_all_but
from tacevo.sandbox.protocol import Header, Message, Sort, describe

#: The arrays that an entry gets: those of the sandbox by name, mapped read-only, or what was made of them (`Equip`).
Arrays = Mapping[str, Any]
#: Sends one frame of the answer: a JSON header and raw bytes. In a job that is scored it waits, and returns whether
#: this frame's score is the lowest so far.
Send = Callable[[Json, bytes], bool | None]
#: A job's code: `run(header, payload, arrays, send)`. What it returns is kept until the process ends, so that a
#: finaliser of the candidate's (an endless `__del__`) cannot delay the answer.
Entry = Callable[[Header, bytes, Arrays, Send], object]
#: Gets a device ready for a job, before its process is confined: `equip(header, payload, arrays)` returns the arrays
#: that the entry gets. No code of the candidate has run then, so what it raises is the sandbox's failure, no verdict,
#: as it is where it takes more time or memory than the job's limits allow. The candidate's own time begins afterwards.
Equip = Callable[[Header, bytes, Arrays], Arrays]
#: The bytes that tell a child of a frame's score.
NOT_LOWEST, LOWEST = 1, 2
_PAUSE, _LONGEST_PAUSE = 0.0005, 0.05  # seconds between two looks at what it was told


def run(
    entry: Entry,
    job: Header,
    payload: bytes,
    arrays: Arrays,
    pipe: int,
    *,
    supervisor: int,
    equip: Equip | None,
    told: mmap.mmap | None,
) -> NoReturn:
    """Turn this fresh fork into a candidate's process, run the entry, and end without clean-up.

    Args:
        entry: the code to run.
        job: `header` for the entry, `limits` as JSON, the level of confinement as `strongest`, `doors`, the patterns of
            device files that a driver may open behind the walls, and `prepared`: whether the zygote has imported all
            that a job may need. If not, the first import of another module is reported as `unprepared` and ends the
            process, so that no answer depends on it.
        payload: bytes for the entry.
        arrays: as the zygote mapped them.
        pipe: file descriptor for answers; the only one that stays open besides the standard streams, which are
            /dev/null.
        supervisor: the process that forked this one; this one ends with it.
        equip: what is called first.
        told: where frames are scored, memory that the supervisor writes to and never reads, because a confined process
            may read no file descriptor: of each frame a byte, 0 until its score is known.
    """

    def say(sort: Sort, header: Json, data: bytes = b"") -> None:
        left = memoryview(Message.of(sort, header, data).to_bytes())
        while left:
            left = left[os.write(pipe, left) :]

    frames = itertools.count()

    def send(header: Json, data: bytes) -> bool | None:
        say(Sort.frame, header, data)
        if told is None:
            return None
        number, pause = next(frames), _PAUSE
        while not told[number]:
            time.sleep(pause)
            pause = min(2 * pause, _LONGEST_PAUSE)  # who waits for long must not pay much processor time for it
        return told[number] == LOWEST

    def lack(*_: object) -> NoReturn:
        say(Sort.unprepared, None)
        os._exit(0)

    try:
        end_with(supervisor)
        os.setsid()
        keep_priority()
        os.chdir("/")
        close_all_but(pipe)
        doors = present(job["doors"])  # now, since nobody may list a directory any more afterwards
        if doors:
            shut_out(doors)
        if equip is not None:
            arrays = equip(job["header"], payload, arrays)
        # No file can be read; without finders of files an import fails at once, and alike everywhere.
        sys.meta_path[:] = [BuiltinImporter, FrozenImporter]
        if not job["prepared"]:
            sys.meta_path.append(SimpleNamespace(find_spec=lack))
        say(Sort.ready, confine(Limits(**job["limits"]), Confinement(job["strongest"]), doors))
        _kept = entry(job["header"], payload, arrays, send)
        say(Sort.done, None)
        os.kill(os.getpid(), signal.SIGSTOP)  # the supervisor takes a last look at the memory, then ends it
    except MemoryError as error:
        say(Sort.starved, None, describe(error).encode())
    except BaseException as error:  # SystemExit too: a candidate must not reach the code of the zygote
        say(Sort.raised, None, describe(error).encode())
    finally:
        os._exit(0)  # no atexit, no finaliser, no flush: no code of the candidate runs after its answer
