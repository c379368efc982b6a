"""A whole search beside openevolve: candidates per hour, processor seconds and peak memory.

    make bench          or, alone: python -m benchmarks.peers

Both get the same work. One server on this machine gives the same answers, each once and in the same order: the first
distinct networks of the first published force run. Each contender trains each of them, and the same baseline, with two
workers, for five epochs on the same 480 images of 32 pixels, and validates every epoch; after each round it is checked
that it trained exactly these sources. The contenders are whole commands, timed from start to end, imports included.
They take turns, after a short round that does not count. The data set is there before; all other stores are empty.

The peer is tuned as its users would tune it: its evaluator (`peer_evaluator.py`) is a plain PyTorch loop in one
thread, channels-last, with fused Adam; it keeps its images and its torch import between candidates, in two worker
processes, with the same malloc settings as ours. Whole answers (`diff_based_evolution: false`), no cascade and no
feedback by a model, so that a candidate is one request and one training; the rest are its defaults.

What ours does and the peer does not: every answer passes the gate's policy and probe; every candidate runs in a
process of its own behind the kernel's walls, without the validation labels; answers, probes, trainings and decisions
are recorded so that the search can be replayed; and generations wait for their last candidate, so that the number of
workers changes no result. Such a new process compiles its kernels, touches its memory and tries two memory layouts
anew, where the peer's workers stay warm. Tracking is off, because the peer has none.
"""

import io
import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import yaml
from rich.console import Console

from benchmarks.confinement import computable
from benchmarks.timing import Cost, Figure, children_seconds
from tacevo.bundles.open import opened
from tacevo.choices import Numerics
from tacevo.config.compose import compose
from tacevo.results.run import read_run
from tacevo.runs.answers import task_without_data
from tacevo.runs.datasets import load_data
from tacevo.runs.progress import Progress
from tacevo.training.numerics import environment

#: Made by `make bench`: a virtual environment of the peer, which sees the packages of ours, so that torch is the same.
PYTHON = Path("build/peers/bin/python")
REQUIREMENT = Path(__file__).with_name("peers.txt").read_text(encoding="utf-8").strip()

EVALUATOR = Path(__file__).with_name("peer_evaluator.py")

FORCE_RUN = Path("tests/golden/bundles/force-grammar.zip")

#: Answers of the round that does not count: enough to read every file and start every process once.
WARM_UP = 2

#: Candidates of a generation, and generations after the first.
GENERATION, GENERATIONS = 10, 3
SETTINGS = ("experiment=published_force", "tracking=none", "executor.workers=2")


@dataclass(frozen=True, slots=True, kw_only=True)
class Work:
    """What a contender gets for one search."""

    #: A new directory, in which it may write.
    place: Path
    #: Address of the server.
    url: str
    #: Where the data set is: in a store of ours, and as the peer's `data.npz`.
    data: Path
    baseline: str
    #: How many to ask for: whole generations.
    answers: int
    epochs: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """How a contender searches."""

    command: Sequence[str]
    environment: Mapping[str, str]
    #: Lists the files of the networks that it has trained.
    trained: Callable[[], Sequence[Path]]


def peers(
    *,
    numerics: Sequence[Numerics] = (),
    answers: int = GENERATION * (1 + GENERATIONS),
    epochs: int = 5,
    rounds: int = 3,
) -> Iterator[Figure]:
    """Search with ours and with openevolve, in turn.

    Args:
        numerics: of ours; by default all that this machine can compute with.
        answers: candidates of a search besides the baseline; in the first round `WARM_UP` at most.
        epochs: of every training.
        rounds: how often to measure; with 0 the first round counts.
    """
    _, task = task_without_data("force", 32)
    sources, numerics = published(answers), numerics or computable()
    contenders: dict[str, Callable[[Work], Search]] = {
        **{choice: partial(ours, choice) for choice in numerics},
        "openevolve": openevolve,
    }
    costs: dict[str, list[Cost]] = {name: [] for name in contenders}
    with tempfile.TemporaryDirectory() as folder:
        write_data(Path(folder), SETTINGS)
        given = [sources[:WARM_UP], *rounds * [sources]]
        for number, served in enumerate(given):
            for name, contender in contenders.items():
                place = Path(folder) / f"{name}{number}"
                place.mkdir()
                with serving(in_order(served)) as url:
                    work = Work(
                        place=place,
                        url=url,
                        data=Path(folder),
                        baseline=task.baseline,
                        answers=len(served),
                        epochs=epochs,
                    )
                    search = contender(work)
                    costs[name].append(search_cost(search.command, search.environment))
                check_trained(name, search.trained(), [task.baseline, *served])
    counted = {name: seconds[1:] or seconds for name, seconds in costs.items()}
    for choice in numerics:
        yield from _figures(counted, choice, 1 + len(given[-1]))


def published(count: int) -> list[str]:
    """Return the first distinct sources that the first published force run trained after its baseline."""
    place = opened(FORCE_RUN)
    names = [candidate.id for candidate in read_run(place.folder).trained[1:]]
    texts = ((place.folder / "candidates" / f"{name}.py").read_text(encoding="utf-8") for name in names)
    return list(dict.fromkeys(texts))[:count]


def ours(numerics: Numerics, work: Work) -> Search:
    """Search as a user does, with new stores."""
    shutil.copytree(work.data / "cache" / "data", work.place / "cache" / "data")
    generation, run = min(work.answers, GENERATION), work.place / "run"
    command = [
        *(sys.executable, "-m", "tacevo.cli.app", "search", *SETTINGS, f"numerics={numerics}"),
        f"search.generations={work.answers // generation - 1}",
        *(f"search.candidates={generation}", f"search.initial={generation}", f"training.epochs={work.epochs}"),
        *("llm=openai", "llm.model=recorded", f"llm.base_url={work.url}"),
        *(f"run.dir={run}", f"store.root={work.place}/cache"),
    ]

    def trained() -> list[Path]:
        return [run / "candidates" / f"{candidate.id}.py" for candidate in read_run(run).trained]

    return Search(command=command, environment={}, trained=trained)


def openevolve(work: Work) -> Search:
    """Search as a user of openevolve does."""
    trained = work.place / "trained"
    trained.mkdir()
    command = openevolve_command(
        work.place, url=work.url, baseline=work.baseline, evaluator=EVALUATOR, answers=work.answers
    )
    given = evaluator_environment(SETTINGS, work.epochs, data=work.data, trained=trained, seed=0)
    return Search(command=command, environment=given, trained=lambda: list(trained.iterdir()))


def openevolve_command(
    place: Path, *, url: str, baseline: str, evaluator: Path, answers: int, seed: int | None = None
) -> list[str]:
    """Write what the peer reads, and return its command: whole answers, one request and one evaluation a candidate.

    Args:
        place: a directory, in which it writes, too.
        url: of the server that answers.
        baseline: the source that it begins with.
        evaluator: the program that it calls for each network.
        answers: to ask for.
        seed: of its own draws; None for its default.
    """
    config = {
        "language": "python",
        "diff_based_evolution": False,
        "llm": {"models": [{"name": "recorded", "api_base": url, "api_key": "none"}]},
        "evaluator": {"parallel_evaluations": 2, "cascade_evaluation": False},
        **({} if seed is None else {"random_seed": seed}),
    }
    (place / "config.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
    (place / "initial.py").write_text(baseline, encoding="utf-8")
    return [
        *(str(PYTHON), "-m", "openevolve.cli", f"{place}/initial.py", str(evaluator)),
        *("--config", f"{place}/config.yaml", "--output", f"{place}/output", "--iterations", str(answers)),
    ]


def evaluator_environment(
    settings: Sequence[str], epochs: int, *, data: Path, trained: Path, seed: int
) -> dict[str, str]:
    """Return the variables by which the peer trains as ours would with these settings.

    Args:
        settings: of a search of ours.
        epochs: of each training.
        data: a directory that `write_data` wrote.
        trained: a directory that gets a copy of each network.
        seed: of all trainings.
    """
    config = compose(settings)
    return environment(Numerics.fast) | {
        "PEER_CLASS": config.task.class_name,
        "PEER_DATA": f"{data}/data.npz",
        "PEER_EPOCHS": str(epochs),
        "PEER_BATCH": str(config.training.batch_size),
        "PEER_LEARNING_RATE": str(config.training.learning_rate),
        "PEER_SEED": str(seed),
        "PEER_TRAINED": str(trained),
    }


def write_data(folder: Path, settings: Sequence[str]) -> None:
    """Make the data set of a search of ours, for ours in a store and for the peer as standardised arrays."""
    data = load_data(compose([*settings, f"store.root={folder}/cache"]), Progress(Console(file=io.StringIO())))
    mean, deviation = (np.array(of, np.float32)[:, None, None] for of in (data.mean, data.deviation))
    images = (np.load(data.images).astype(np.float32) - mean) / deviation
    np.savez(folder / "data.npz", images=images, targets=data.targets, train=data.train, validation=data.validation)


def in_order(answers: Sequence[str]) -> Callable[[str], str | None]:
    """Give each answer once, whatever is asked."""
    left = iter(answers)
    return lambda _: next(left, None)


@contextmanager
def serving(answer_to: Callable[[str], str | None]) -> Iterator[str]:
    """Serve the chat-completions API without delay; yield the address.

    A peer's worker waits for its answer, while ours asks for a generation at a time: a server that takes no time
    favours the peer.

    Args:
        answer_to: the network that answers the last message of a request; None for an error. Requests wait for it in
            threads of their own.
    """

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            asked = json.loads(self.rfile.read(int(self.headers["content-length"])))
            answer = answer_to(asked["messages"][-1]["content"])
            if answer is None:
                self.send_error(410)
                return
            message = {"role": "assistant", "content": f"```python\n{answer}```"}
            choice = {"index": 0, "message": message, "finish_reason": "stop"}
            usage = {"prompt_tokens": 0, "completion_tokens": 0, "total_tokens": 0}
            chat = {"id": "0", "object": "chat.completion", "created": 0, "model": "recorded"}
            body = json.dumps({**chat, "choices": [choice], "usage": usage}).encode()
            self.send_response(200)
            self.send_header("content-type", "application/json")
            self.send_header("content-length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            """Print nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/v1"
        server.shutdown()


def search_cost(command: Sequence[str], more: Mapping[str, str]) -> Cost:
    """Run a contender's command to its end; its memory is the peak of all its processes together.

    Args:
        command: with its arguments.
        more: variables of the environment, beside those of this process.

    Raises:
        RuntimeError: it failed; with its output.
    """
    before, began, peak = children_seconds(), time.perf_counter(), 0
    with tempfile.TemporaryFile("w+") as log:
        with subprocess.Popen(command, env={**os.environ, **more}, stdout=log, stderr=log) as process:
            while process.poll() is None:
                peak = max(peak, _memory(process.pid))
                time.sleep(0.25)
        seconds = time.perf_counter() - began
        if process.returncode:
            log.seek(0)
            raise RuntimeError(f"{' '.join(command)} failed: {log.read()}")
    return Cost(seconds=seconds, processor_seconds=children_seconds() - before, memory=peak * 1024 / 1e6)


def _memory(process: int) -> int:
    """Return the memory of a process and of all below it, in KiB; a page that several share counts once."""
    below: dict[int, list[int]] = {}
    for file in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has just ended
            below.setdefault(int(file.read_text().rpartition(")")[2].split()[1]), []).append(int(file.parent.name))
    processes, total = [process], 0
    for one in processes:
        processes += below.get(one, [])
        total += _own_memory(Path(f"/proc/{one}"))
    return total


def _own_memory(process: Path) -> int:
    """Return a process's memory in KiB, with its part of shared pages, or with all of them where only root may know."""
    with suppress(OSError):
        try:
            field = re.search(r"^Pss: +(\d+)", (process / "smaps_rollup").read_text(), re.MULTILINE)
        except PermissionError:
            field = re.search(r"^VmRSS:\s+(\d+)", (process / "status").read_text(), re.MULTILINE)
        return int(field[1]) if field else 0
    return 0


def check_trained(name: str, files: Sequence[Path], sources: Sequence[str]) -> None:
    """Check that a contender trained each of these networks once, and no other.

    Raises:
        RuntimeError: it did not.
    """
    texts = [file.read_text(encoding="utf-8") for file in files]
    if sorted(map(str.strip, texts)) != sorted(map(str.strip, sources)):
        raise RuntimeError(f"{name} trained {len(texts)} networks, which are not the {len(sources)} that it was given")


def _figures(costs: Mapping[str, Sequence[Cost]], choice: Numerics, candidates: int) -> Iterator[Figure]:
    """Compare the medians of one of ours with the peer's."""
    rivals = (choice, "openevolve")
    seconds, processor, memory = (
        [statistics.median(getattr(cost, of) for cost in costs[name]) for name in rivals]
        for of in ("seconds", "processor_seconds", "memory")
    )
    rates = [3600 * candidates / value for value in seconds]
    shown = (
        ("speed", rates, "candidates/h"),
        ("processor time", processor, "CPU s"),
        ("peak memory", memory, "MB"),
    )
    for what, (mine, theirs), unit in shown:
        yield Figure(
            title=f"{what} of a search of {candidates} candidates",
            name=f"numerics={choice}",
            value=mine,
            unit=unit,
            peer="openevolve",
            peer_value=theirs,
            more_is_better=what == "speed",
        )


if __name__ == "__main__":
    for figure in peers():
        print(figure)
