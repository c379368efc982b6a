"""`tacevo publish`: a finished run, its studies and all that follows from them, gathered into one bundle.

Equal runs give equal bytes wherever, whenever and by whomever they are published, under one version of this package, of
Matplotlib and of the libraries that compress. Nothing in a bundle names a folder or a host of the machine.
"""

import json
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tacevo import solid
from tacevo.bundle import LOCK, MANIFEST, RUN_FILES, STORE, private_folder, sealed
from tacevo.confdir import conf_root
from tacevo.crate import metadata
from tacevo.errors import ConfigError, RunError
from tacevo.papers import Subject, Terms, citation, licence, readme
from tacevo.progress import View
from tacevo.records import Json
from tacevo.replaying import Replayed, replay
from tacevo.rundir import PACKAGES, RunDirectory
from tacevo.store import write_durably
from tacevo.studydir import StudyDirectory, studies_of
from tacevo.studying import replay_studies
from tacevo.verifying import check_records


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """What a user wants published, and how."""

    #: The folder of the run.
    run: Path
    #: Folders of its studies; none for all that are finished.
    studies: tuple[Path, ...] = ()
    #: Where the stores lie, if not where the run had them.
    store: Path | None = None
    #: SPDX identifier.
    licence: str = "CC-BY-4.0"
    authors: tuple[str, ...] = field(default=())
    #: As YYYY-MM-DD; None for the day on which the run ended.
    published: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Published:
    """A bundle that was written."""

    #: Of the run's ledger.
    run: str
    #: Of the bundle: SHA-256 of its manifest.
    digest: str
    #: Files in it, and its size in bytes.
    files: int
    size: int


def publish(
    request: Request,
    target: Path,
    *,
    make_pages: Callable[[Path, Path], tuple[Mapping[str, bytes], Mapping[str, bytes]]],
    view: View,
) -> Published:
    """Replay a finished run and its studies, and write all that belongs to it into one file.

    Args:
        request: what to publish.
        target: the file to write; one that stands there is replaced.
        make_pages: gives the files of every table, and those of every figure, from the folders of run and stores.
        view: who is told.

    Raises:
        DivergenceError: the run is not what its stores give.
        CacheMissError: a store lacks an answer.
        RunError: this is no finished run, or a study is none of its finished ones.
        ConfigError: licence, date or an author cannot be used.
    """
    directory = RunDirectory(request.run)
    ledger = directory.read_finished()
    run = _publishable(directory)
    terms = Terms(licence=request.licence, authors=request.authors, published=_day(request))
    store = request.store or Path(directory.read_run()["config"]["store"]["root"])
    with private_folder(request.run.parent) as folder:
        staged = folder / run["name"]
        _stage(request, run, staged, view)
        read: set[Path] = set()
        replayed = replay(staged, str(store), view, seen=read.add)
        studies = replay_studies(staged, str(store), view, seen=read.add)
        check_records(staged, replayed)
        candidates = sum(line["kind"] == "candidate" for line in ledger)
        tables, figures = make_pages(staged, store)
        members = {
            **_run_members(staged, replayed),
            STORE: solid.pack(json.loads(path.read_bytes()) for path in read),
            **_in_folder("tables", tables),
            **_in_folder("figures", figures),
        }
    members |= _papers(Subject(run=run, candidates=candidates, studies=studies), terms, members)
    data, digest = sealed(members)
    write_durably(target, data)
    return Published(run=replayed.digest, digest=digest, files=len(members) + 1, size=len(data))


def _publishable(directory: RunDirectory) -> dict[str, Json]:
    """Read run.json without what belongs to one machine: paths, addresses, a tracker.

    None of it is part of the run's identity (`tacevo.config.identity`).
    """
    run = directory.read_run()
    with directory.believed():
        config = run["config"]
        data, llm, task = config["data"], config["llm"], config["task"]
        published = {
            **config,
            "data": {**data, "root": None if data["root"] is None else Path(data["root"]).name},
            "llm": {**llm, "base_url": None, "prices": Path(llm["prices"]).name},
            "task": {**task, **{key: _relative(task[key]) for key in ("baseline", "instructions", "system")}},
            "tracking": {**config["tracking"], "kind": "none", "uri": ""},
            "store": {**config["store"], "root": "cache"},
            "run": {**config["run"], "dir": None},
        }
        return {**run, "name": run["name"] or "run", "config": published}


def _relative(path: str) -> str:
    return Path(path).name if Path(path).is_absolute() else path


def _day(request: Request) -> str:
    """Give the day of publication: by default the last one in the run's timings, so that it is the run's own.

    Raises:
        ConfigError: there is none.
    """
    if request.published is not None:
        return request.published
    path = request.run / "timings.jsonl"
    try:
        last = path.read_text(encoding="utf-8").splitlines()[-1]
        return str(json.loads(last)["at"])[: len("YYYY-MM-DD")]
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise ConfigError(f"{path} does not say when the run ended; give the day with --date YYYY-MM-DD") from error


def _stage(request: Request, run: dict[str, Json], staged: Path, view: View) -> None:
    """Lay what is to be published of a run into a folder of the run's own name, which tables and figures bear."""
    shutil.copytree(request.run / "candidates", staged / "candidates")
    for name in RUN_FILES:
        source = request.run / name
        if source.exists() and name != "run.json":
            shutil.copy(source, staged / name)
    RunDirectory(staged).write_json("run.json", run)
    for study in _studies(request, str(run["digest"]), view):
        folder = staged / "studies" / study.path.name
        folder.mkdir(parents=True)
        for name in ("study.json", "scores.jsonl"):
            shutil.copy(study.path / name, folder / name)


def _studies(request: Request, digest: str, view: View) -> list[StudyDirectory]:
    """Choose the studies: those that were named, or all that are finished.

    Raises:
        RunError: one that was named is not a finished study of this run.
    """
    every = studies_of(request.run)
    whole = [study for study in every if _is_finished(study, digest)]
    if not request.studies:
        for study in every:
            if study not in whole:
                view.say(f"study {study.path.name} is not a finished one of the run as it is, and is left out")
        return whole
    by_place = {study.path.resolve(): study for study in whole}
    for path in request.studies:
        if path.resolve() not in by_place:
            finished = ", ".join(str(study.path) for study in whole) or "none"
            raise RunError(f"{path} is not the folder of a finished study of {request.run}; finished: {finished}")
    return [by_place[place] for place in sorted({path.resolve() for path in request.studies})]


def _is_finished(study: StudyDirectory, digest: str) -> bool:
    recorded = study.read()
    return recorded.get("digest") is not None and recorded.get("run") == digest


def _run_members(staged: Path, replayed: Replayed) -> dict[str, bytes]:
    """Read the files of a staged run: those that were compared."""
    paths = [staged / name for name in RUN_FILES if (staged / name).exists()]
    paths += [staged / "candidates" / name for name in replayed.files]
    paths += staged.glob("studies/*/*")
    return {f"run/{path.relative_to(staged).as_posix()}": path.read_bytes() for path in paths}


def _in_folder(folder: str, files: Mapping[str, bytes]) -> dict[str, bytes]:
    return {f"{folder}/{name}": content for name, content in files.items()}


def _papers(subject: Subject, terms: Terms, members: Iterable[str]) -> dict[str, bytes]:
    """Write what describes a bundle, the metadata last: it lists all others."""
    lock = _lock(subject.run["versions"])
    texts = {
        "README.md": readme(subject, has_lock=lock is not None),
        "LICENSE.txt": licence(terms),
        "CITATION.cff": citation(subject, terms),
        **({} if lock is None else {LOCK: lock}),
    }
    texts["ro-crate-metadata.json"] = metadata(subject, terms, [*members, *texts, MANIFEST])
    return {name: text.encode() for name, text in texts.items()}


def _lock(versions: Mapping[str, str]) -> str | None:
    """Read the lock file of this package, if it came with one and it is of the versions that the run had."""
    path = conf_root().parent / LOCK
    if not path.exists():
        return None
    text = path.read_text(encoding="utf-8")
    locked = dict(_pins(text.splitlines()))
    compared = [name for name in PACKAGES if name != "tacevo" and versions.get(name, "absent") != "absent"]
    agree = all(locked.get(name) == versions[name].partition("+")[0] for name in compared)  # torch adds its build
    return text if agree else None


def _pins(lines: Sequence[str]) -> Iterable[tuple[str, str]]:
    for line in lines:
        name, pinned, version = line.partition("==")
        if pinned:
            yield name.lower().replace("_", "-"), version.strip()
