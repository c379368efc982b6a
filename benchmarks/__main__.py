"""`make bench`: speed and memory beside a peer, measured in the same run; README.md says how to read a figure."""

import io
import itertools
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image
from ribs.archives import CVTArchive
from rich.console import Console

from benchmarks import confinement
from benchmarks.commits import commits
from benchmarks.llm import asking, memory_of_many
from benchmarks.replay import synthetic_replays
from benchmarks.timing import medians, report
from tacevo.choices import Numerics, SensorTask
from tacevo.cli.inspect import task_without_data
from tacevo.config.compose import compose
from tacevo.config.recorded import read_recorded
from tacevo.data.sources.images import decode
from tacevo.randomness import stream
from tacevo.records import Json, Limits, to_json
from tacevo.reproduce.replay import replay
from tacevo.runs.datasets import source_of
from tacevo.runs.progress import Progress
from tacevo.runs.session import search
from tacevo.sandbox.client import Sandbox
from tacevo.search.archive import Archive, Elite, Tessellation, insert
from tacevo.tracking.process import Mirror
from tacevo.training.numerics import environment

INSERTIONS = 5_000
FORKS = 8
PICTURES = 70


def archive_insertions() -> str:
    """Insert one by one into 100 niches, as a search does; the peer is pyribs."""
    rng = stream(0, "bench")
    centroids, points, objectives = rng.random((100, 2)), rng.random((INSERTIONS, 2)), rng.random(INSERTIONS)
    tessellation = Tessellation(centroids)

    def ours() -> None:
        archive = Archive()
        for index in range(INSERTIONS):
            elite = Elite(name=str(index), objective=float(objectives[index]))
            archive, _ = insert(archive, tessellation.niche_of(points[index]), elite)

    def peer() -> None:
        archive = CVTArchive(solution_dim=1, centroids=centroids, ranges=[(0, 1), (0, 1)])
        for index in range(INSERTIONS):
            archive.add_single(np.zeros(1), objectives[index], points[index])

    found = medians({"tacevo": ours, "pyribs": peer}, rounds=5)
    return report("archive, one insertion at a time", found, unit="insertions", per_second=INSERTIONS)


def candidate_processes() -> str:
    """Judge a baseline in a confined fork; the peer starts an interpreter and imports torch, as usual elsewhere."""
    _, task = task_without_data("force", 32)
    sizes = {"parameters": 10**9, "flops": 10**12, "modules": 10_000}
    header: Json = {"source": task.baseline, "contract": to_json(task.contract), "limits": sizes}
    limits = Limits(seconds=60, memory_mib=2048)
    with Sandbox(
        entries={"probe": "tacevo.gate.probe:run"}, environment=environment(Numerics.portable), arrays={}
    ) as sandbox:
        sandbox.run("probe", header, b"", limits)  # the zygote starts with the first job

        def ours() -> None:
            for _ in range(FORKS):
                sandbox.run("probe", header, b"", limits)

        def peer() -> None:
            for _ in range(FORKS):
                subprocess.run([sys.executable, "-c", "import torch"], check=True)

        found = medians({"fork and probe": ours, "bare `python -c 'import torch'`": peer}, rounds=3)
    return report("a candidate's process", found, unit="candidates", per_second=FORKS)


def pictures() -> str:
    """Draw 256 pixel images in one process; the peer decodes the same images from PNG files."""
    return "\n".join(_pictures(task) for task in SensorTask)


def _pictures(task: SensorTask) -> str:
    pictures = source_of(compose([f"task={task}", f"data.images={PICTURES}"])).catalogue().pictures
    drawn = [draw() for draw in pictures]
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"{index}.png" for index in range(PICTURES)]
        for file, image in zip(files, drawn, strict=True):
            Image.fromarray(image.transpose(1, 2, 0)).save(file)
        rivals = {
            "drawn": lambda: [draw() for draw in pictures],
            "decoded": lambda: [decode(file, 256) for file in files],
        }
        return report(f"{task} images of 256 px", medians(rivals, rounds=5), unit="images", per_second=PICTURES)


def replaying() -> str:
    """Replay a small search from its stores; the peer is its recording."""
    small = ["experiment=demo", "tracking=none", "search.generations=2", "data.images=120", "training.epochs=1"]
    with tempfile.TemporaryDirectory() as folder:
        places = [f"run.dir={folder}/run", f"store.root={folder}/cache"]
        view = _silent()
        recorded = medians({"recording": lambda: search(compose([*small, *places]), view)}, rounds=1)
        replayed = medians({"replay": lambda: replay(read_recorded(Path(folder) / "run"), view)}, rounds=5)
    return report("replay of 21 candidates", {**replayed, **recorded}, unit="s")


def workers() -> str:
    """Search with two workers; the peer is one worker."""
    small = ["experiment=demo", "tracking=none", "search.generations=1", "data.images=240", "training.epochs=2"]

    def with_workers(count: int) -> None:
        with tempfile.TemporaryDirectory() as folder:
            places = [f"run.dir={folder}/run", f"store.root={folder}/cache", f"executor.workers={count}"]
            search(compose([*small, *places]), _silent())

    found = medians({"two workers": lambda: with_workers(2), "one worker": lambda: with_workers(1)}, rounds=3)
    return report("a search of 13 candidates", found, unit="s")


def tracking() -> str:
    """Search with MLflow as its mirror, in a database that exists already; the peer is tracking=none."""
    small = ["experiment=demo", "search.generations=2", "data.images=240", "training.epochs=2"]
    with tempfile.TemporaryDirectory() as folder:
        uri = f"sqlite:///{folder}/mlflow.db"
        places = (Path(folder) / f"run{number}" for number in itertools.count())

        def with_tracking(*choice: str) -> Path:
            place = next(places)
            search(compose([*small, *choice, f"run.dir={place}", f"store.root={place}-cache"]), _silent())
            return place

        untracked = with_tracking("tracking=none")
        _mirror(untracked, uri)  # makes the database
        rivals = {
            "with MLflow": lambda: with_tracking("tracking=mlflow", f"tracking.uri={uri}"),
            "without": lambda: with_tracking("tracking=none"),
        }
        figures = report("tracking of 21 candidates", medians(rivals, rounds=3), unit="s")
        return f"{figures}; the mirror alone takes {_mirror_cpu_seconds(with_tracking('tracking=none'), uri):.1f} CPU s"


def _mirror(run: Path, uri: str) -> None:
    """Mirror a finished run as a search does, and wait for the end."""
    mirror = Mirror(run, uri=uri, experiment="tacevo")
    mirror.start()
    warning = mirror.finish(None)
    if warning is not None:
        raise RuntimeError(warning)


def _mirror_cpu_seconds(run: Path, uri: str) -> float:
    """Mirror a finished run; give the processor seconds of the mirror's process, which is the only one to end."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    _mirror(run, uri)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return (after.ru_utime + after.ru_stime) - (before.ru_utime + before.ru_stime)


def memory() -> str:
    """Return the peak resident memory of a process that replays, and whether it imported torch."""
    script = (
        "import resource, sys; from tacevo.cli.app import main; main(sys.argv[1:]); "
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024, 'torch' in sys.modules)"
    )
    with tempfile.TemporaryDirectory() as folder:
        small = ["experiment=demo", "tracking=none", "search.generations=0", "data.images=40", "training.epochs=1"]
        command = [sys.executable, "-c", script, "search", *small]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    peak, torch = done.stdout.split()[-2:]
    return f"peak memory of the process that searches: {peak} MiB (torch imported: {torch})"


def _silent() -> Progress:
    return Progress(Console(file=io.StringIO()))


def main() -> None:
    """Print one line a figure."""
    for measure in (
        archive_insertions,
        commits,
        candidate_processes,
        confinement.walls,
        confinement.training,
        pictures,
        workers,
        replaying,
        synthetic_replays,
        tracking,
        asking,
        memory,
        memory_of_many,
    ):
        print(measure(), flush=True)


if __name__ == "__main__":
    main()
