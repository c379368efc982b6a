"""`make bench`: speed and memory beside a peer, measured in the same run; its README says how to read a figure.

`make bench-quick` runs every benchmark once on next to nothing: it shows that they run, and its figures mean nothing.
"""

import argparse
import datetime
import io
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from ribs.archives import CVTArchive
from rich.console import Console

from benchmarks import confinement
from benchmarks.llm import asking, memory_of_many
from benchmarks.peers import REQUIREMENT, peers
from benchmarks.record import record, write
from benchmarks.replay import command_cost, synthetic_replays
from benchmarks.share import beside_training
from benchmarks.timing import Figure, children_seconds, medians, report
from tacevo.choices import Numerics, SensorTask
from tacevo.config.compose import compose
from tacevo.data.sources.image_files import decode
from tacevo.evolution.archive import Archive, Elite, Tessellation, insert
from tacevo.randomness import stream
from tacevo.records import Json, to_json
from tacevo.reproduce.replay import replay
from tacevo.results.run import read_run
from tacevo.runs.answers import task_without_data
from tacevo.runs.datasets import source_of
from tacevo.runs.progress import Progress
from tacevo.runs.session import search
from tacevo.sandbox.client import Sandbox
from tacevo.tracking.tracker import Mirror
from tacevo.training.numerics import environment

PAGE = Path("benchmarks/README.md")
RESULTS = Path("benchmarks/results/bench.json")

#: Settings of a force search that is soon over.
NICHES = ("archive.niches=25", "archive.prompt_niches=25")
SIZES = ("search.generations=1", "search.initial=5", "data.images=240", "training.epochs=2")
SMALL = ("experiment=published_force", "tracking=none", *NICHES, *SIZES)
TINY = (*SMALL, "search.generations=0", "search.initial=1", "data.images=40", "training.epochs=1")


def archive_insertions(*, insertions: int = 5_000, rounds: int = 5) -> Figure:
    """Insert one by one into 100 niches, as a search does; the peer is pyribs."""
    rng = stream(0, "bench")
    centroids, points, objectives = rng.random((100, 2)), rng.random((insertions, 2)), rng.random(insertions)
    tessellation = Tessellation(centroids)

    def ours() -> None:
        archive = Archive()
        for index in range(insertions):
            elite = Elite(name=str(index), objective=float(objectives[index]))
            archive, _ = insert(archive, tessellation.niche_of(points[index]), elite)

    def peer() -> None:
        archive = CVTArchive(solution_dim=1, centroids=centroids, ranges=[(0, 1), (0, 1)])
        for index in range(insertions):
            archive.add_single(np.zeros(1), objectives[index], points[index])

    rates = medians({"tacevo": ours, "pyribs": peer}, rounds=rounds)
    return report("archive, one insertion at a time", rates, unit="insertions", count=insertions)


def candidate_processes(*, forks: int = 8, rounds: int = 3) -> Figure:
    """Judge a baseline in a confined fork; the peer starts an interpreter and imports torch, as usual elsewhere."""
    _, task = task_without_data("force", 32)
    header: Json = {"source": task.baseline, "contract": to_json(task.contract)}
    with Sandbox(
        entries={"probe": "tacevo.gate.probe:run"}, environment=environment(Numerics.portable), arrays={}
    ) as sandbox:
        confinement.probe(sandbox, header)  # the zygote starts with the first job

        def ours() -> None:
            for _ in range(forks):
                confinement.probe(sandbox, header)

        def peer() -> None:
            for _ in range(forks):
                subprocess.run([sys.executable, "-c", "import torch"], check=True)

        rates = medians({"fork and probe": ours, "bare `python -c 'import torch'`": peer}, rounds=rounds)
    return report("a candidate's process", rates, unit="candidates", count=forks)


def pictures(*, images: int = 30, rounds: int = 5) -> Iterator[Figure]:
    """Draw 256 pixel images in one process; the peer decodes the same images from PNG files."""
    return (_pictures(task, images, rounds) for task in SensorTask)


def _pictures(task: SensorTask, images: int, rounds: int) -> Figure:
    pictures = source_of(compose([f"task={task}", f"data.images={images}"])).catalogue().pictures
    drawn = [draw() for draw in pictures]
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"{index}.png" for index in range(images)]
        for file, image in zip(files, drawn, strict=True):
            Image.fromarray(image.transpose(1, 2, 0)).save(file)
        rivals = {
            "drawn": lambda: [draw() for draw in pictures],
            "decoded": lambda: [decode(file, 256) for file in files],
        }
        return report(f"{task} images of 256 px", medians(rivals, rounds=rounds), unit="images", count=images)


def replaying(*, settings: Sequence[str] = SMALL, rounds: int = 5) -> Figure:
    """Replay a small search from its stores; the peer is its recording, timed once, because it comes first."""
    with tempfile.TemporaryDirectory() as folder:
        recorded = medians({"recording": lambda: _search(Path(folder), *settings)}, rounds=1)
        run = Path(folder) / "run"
        replayed = medians({"replay": lambda: replay(read_run(run), _silent())}, rounds=rounds)
    return report("replay of a small search", {**replayed, **recorded}, unit="s")


def workers(*, settings: Sequence[str] = SMALL, rounds: int = 3) -> Figure:
    """Search with two workers; the peer is one worker."""

    def with_workers(count: int) -> None:
        with tempfile.TemporaryDirectory() as folder:
            _search(Path(folder), *settings, f"executor.workers={count}")

    rates = medians({"two workers": lambda: with_workers(2), "one worker": lambda: with_workers(1)}, rounds=rounds)
    return report("a small search", rates, unit="s")


def tracking(*, settings: Sequence[str] = SMALL, rounds: int = 3) -> Iterator[Figure]:
    """Search with MLflow as its mirror, in a database that exists already; the peer is tracking=none."""
    with tempfile.TemporaryDirectory() as folder:
        uri = f"sqlite:///{folder}/mlflow.db"
        places: list[Path] = []

        def tracked(*choice: str) -> None:
            places.append(Path(folder) / str(len(places)))
            _search(places[-1], *settings, *choice)

        tracked()
        _mirror(places[-1] / "run", uri)  # makes the database
        rivals = {
            "with MLflow": lambda: tracked("tracking=mlflow", f"tracking.uri={uri}"),
            "without": tracked,
        }
        yield report("tracking of a small search", medians(rivals, rounds=rounds), unit="s")
        before = children_seconds()
        _mirror(places[-1] / "run", uri)
        seconds = children_seconds() - before
    yield Figure(title="tracking of a finished search", name="the mirror's process", value=seconds, unit="CPU s")


def _search(place: Path, *settings: str) -> None:
    """Search in a directory, with stores of its own."""
    search(compose([*settings, f"run.dir={place}/run", f"store.root={place}/cache"]), _silent())


def _mirror(run: Path, uri: str) -> None:
    """Mirror a finished run as a search does, and wait for the end."""
    mirror = Mirror([run], uri=uri, experiment="tacevo")
    warning = mirror.finish(None)
    if warning is not None:
        raise RuntimeError(warning)


def memory(*, settings: Sequence[str] = SMALL) -> Figure:
    """Return the peak resident memory of the process that searches."""
    with tempfile.TemporaryDirectory() as folder:
        cost = command_cost("search", *settings, f"run.dir={folder}/run", f"store.root={folder}/cache")
    return Figure(title="peak memory", name="the process that searches", value=cost.memory, unit="MB")


def _silent() -> Progress:
    return Progress(Console(file=io.StringIO()))


#: What is measured, each with the sizes of `make bench-quick`.
BENCHMARKS: Mapping[Callable[..., Figure | Iterable[Figure]], Mapping[str, Any]] = {
    peers: {"numerics": [Numerics.fast], "answers": 1, "epochs": 1, "rounds": 0},
    archive_insertions: {"insertions": 50, "rounds": 1},
    candidate_processes: {"forks": 1, "rounds": 1},
    confinement.walls: {"rounds": 1},
    confinement.training: {"epochs": {64: 1}, "rounds": 1},
    pictures: {"images": 10, "rounds": 1},
    workers: {"settings": TINY, "rounds": 1},
    replaying: {"settings": TINY, "rounds": 1},
    synthetic_replays: {"generations": [0]},
    tracking: {"settings": TINY, "rounds": 1},
    beside_training: {"settings": TINY},
    asking: {"count": 10, "rounds": 1},
    memory: {"settings": TINY},
    memory_of_many: {"many": 10},
}


def main() -> None:
    """Print one line a figure; write all of them down, unless they are quick."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="every benchmark once on next to nothing; write nothing")
    quick = parser.parse_args().quick
    figures: list[Figure] = []
    for measure, tiny in BENCHMARKS.items():
        measured = measure(**(tiny if quick else {}))
        for figure in [measured] if isinstance(measured, Figure) else measured:
            print(figure, flush=True)
            figures.append(figure)
    if not quick:
        write(record(figures, datetime.date.today().isoformat(), REQUIREMENT.partition("==")[2]), RESULTS, PAGE)


if __name__ == "__main__":
    main()
