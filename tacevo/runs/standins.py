"""What stands in for the sandbox and its threads in a replay, so that one works on a machine that has no sandbox."""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import NoReturn, ParamSpec, TypeVar

from tacevo.errors import SandboxError
from tacevo.records import Json, Limits

P = ParamSpec("P")

T = TypeVar("T")


def refuse_to_run(entry: str, header: Json, payload: bytes, limits: Limits) -> NoReturn:
    """Refuse the job of a sandbox; stores that only read never start one.

    Raises:
        SandboxError: always.
    """
    raise SandboxError("a job for a sandbox", expected=f"every {entry} in the stores", remedy="record the run again")


class InPlace(Executor):
    """Does each job in the thread that submits it, at once: recorded answers leave nothing to wait for."""

    def submit(self, work: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Return the finished future of a job; what the job raised is raised where the future is read."""
        future: Future[T] = Future()
        try:
            future.set_result(work(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future
