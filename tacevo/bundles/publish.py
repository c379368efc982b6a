"""`tacevo publish`: a finished run or sweep, its studies and all that follows from them, gathered into one bundle.

Equal runs give equal bytes wherever, whenever and by whomever they are published, under one version of this package, of
Matplotlib and of the libraries that compress. Nothing in a bundle names a directory or a host of the machine.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tacevo.bundles.format import LOCK, RUN_FILES, STORE, SWEEP, candidate_entry, sealed
from tacevo.bundles.open import Opened, located
from tacevo.bundles.readme import Subject, Terms, citation, licence, readme
from tacevo.bundles.signing import signature_of_digest, signature_place
from tacevo.bundles.verify import Rerun, files_below, rerun, rerun_all
from tacevo.config.conf_folder import conf_root
from tacevo.config.identity import config_hash
from tacevo.environment import PACKAGES
from tacevo.errors import ConfigError, RunError
from tacevo.parts.facts import provider_facts
from tacevo.results.publishable import check_name, published_config, published_overrides
from tacevo.results.run import RecordedRun, read_run
from tacevo.results.settings import settings_of
from tacevo.results.study_directory import StudyDirectory, plain_study, studies_of
from tacevo.results.study_lines import ScoreLine
from tacevo.results.summary import summarise
from tacevo.results.sweep_jobs import check_jobs
from tacevo.rules import PAGES
from tacevo.runs.progress import Progress
from tacevo.storage.array_store import KIND
from tacevo.storage.canonical import readable, value_at
from tacevo.storage.entries import pack
from tacevo.storage.files import write_durably
from tacevo.storage.members import Member, as_tree
from tacevo.storage.notes import NOTE, read_note
from tacevo.storage.run_directory import MANIFEST, PARTS, RunDirectory, RunRecord, run_text, timing_text
from tacevo.storage.signatures import checked_key
from tacevo.storage.store import Entry, read_entry
from tacevo.storage.sweep_directory import Job, SweepDirectory, SweepTerms, name_arm
from tacevo.storage.zipfiles import names_in

#: A version of a package, which `absent` is not.
_VERSION = re.compile(r"[0-9][\w.!-]*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Published:
    """A bundle that was written."""

    subject: Subject
    #: SHA-256 of its manifest.
    digest: str
    #: Files in it, and its size in bytes.
    files: int
    size: int
    #: The number of labels of test images in the bundle, because its studies keep them; each test set of a study counts
    #: once.
    test_labels: int


def publish(
    run: Path,
    target: Path,
    *,
    terms: Terms,
    make_pages: Callable[[Path, Sequence[Rerun]], tuple[Mapping[str, bytes], Mapping[str, bytes]]],
    view: Progress,
    studies: Sequence[Path],
    store: Path | None,
    key: Path | None = None,
) -> Published:
    """Replay a finished run or sweep with its studies, and write all that belongs to it into one file.

    Args:
        run: the directory of the run, or of the sweep.
        target: the file to write; a bundle that stands there is replaced.
        terms: of publication; without a day, it is that on which the run, or the last one of the sweep, ended.
        make_pages: returns the files of every table, and those of every figure, from the directory of a run or a
            sweep and from what was read of its runs.
        view: shows how far the replay is.
        studies: directories of its studies; none for all that are finished. Those of a sweep are not chosen.
        store: where the stores lie, if not where the run had them.
        key: the file of an SSH key, with which the bundle digest is signed into a file beside the bundle; the
            signature of a bundle that is replaced by another one is removed.

    Raises:
        DivergenceError: a run is not what its stores give, or not what its sweep says.
        CacheMissError: a store lacks an answer.
        RunError: this is not a finished run or sweep, or a study is not one of its finished ones.
        ConfigError: another file than a bundle stands there; the day is not known; or a model is named by a path of
            this machine; or the key cannot sign.
    """
    if key is not None:
        checked_key(key)
    place = located(run)
    if target.exists() and STORE not in (names_in(target) or ()):
        raise ConfigError("another file", place=str(target), expected="no file, or a bundle, which is replaced")
    terms = terms if terms.published else replace(terms, published=max(_last_day(path) for path in place.runs))
    staged = _staged(studies, replace(place, entries=store or place.store), view)
    read: set[Path] = set()
    runs = rerun_all(staged, lambda path: rerun(staged.read(path), view, seen=read.add), view)
    tables, figures = make_pages(staged.folder, runs)
    members = {
        **_members(staged, runs),
        STORE: pack(map(_checked, _entries(staged, runs, read))),
        **_in_folder("tables", tables),
        **_in_folder("figures", figures),
    }
    subject = _subject(staged, runs)
    members |= _papers(subject, terms, members)
    data, digest = sealed(members)
    signature = None if key is None else signature_of_digest(digest, key)
    beside = signature_place(target)
    if not (target.exists() and target.read_bytes() == data):
        beside.unlink(missing_ok=True)
    write_durably(target, data)
    if signature is not None:
        write_durably(beside, signature)
    return Published(
        subject=subject, digest=digest, files=len(members) + 1, size=len(data), test_labels=_test_labels(staged, runs)
    )


def _staged(studies: Sequence[Path], place: Opened, view: Progress) -> Opened:
    """Return what is published of a run or a sweep, in memory, under a name that tables and figures may bear."""
    if place.jobs is None:
        run = read_run(place.folder)
        files, name = _stage(run, _studies(studies, run, view)), _publishable(run.record).name
        return replace(place, folder=Member(str(place.folder), as_tree(files), name=name))
    if studies:
        expected = "no study: a sweep is published with every finished study of its runs"
        raise RunError(", ".join(map(str, studies)), expected=expected)
    directory = SweepDirectory(place.folder)
    check_jobs(directory)
    files = _note(place.folder)
    for source in place.runs:
        run = read_run(source)
        files |= {f"{source.name}/{name}": data for name, data in _stage(run, _studies((), run, view)).items()}
    sweep, tree = directory.read(), as_tree(files)
    staged = replace(place, folder=Member(str(place.folder), tree, name=SWEEP))
    jobs = tuple(_published_job(staged.folder, job) for job in sweep.jobs)
    arms = {job.arm: shown.arm for job, shown in zip(sweep.jobs, jobs, strict=True)}
    published = replace(sweep, overrides=(), jobs=jobs, terms=published_terms(sweep.terms, arms))
    tree["sweep.json"] = published.text.encode()
    return staged


def published_terms(terms: SweepTerms, arms: Mapping[str, str]) -> SweepTerms:
    """Return the terms of a sweep with the published name of the reference, by the names of the arms."""
    return replace(terms, reference=arms.get(terms.reference or "", terms.reference))


def _published_job(folder: Path, job: Job) -> Job:
    """Return a job without its overrides: the run that was staged records all settings, and no path of the machine.

    A job that comes from a bundle has no overrides, and keeps the name of its arm.
    """
    config = settings_of(RunDirectory(folder / job.name))
    arm = name_arm(published_overrides(job.overrides)) if job.overrides else job.arm
    return replace(job, arm=arm, overrides=(), config=config_hash(config))


def _publishable(record: RunRecord) -> RunRecord:
    """Return what run.json holds without what belongs to one machine: paths, addresses, a tracker.

    None of it is part of the run's identity (`tacevo.config.identity.identity`).
    """
    config, llm = published_config(record.config), record.config.get("llm")
    # An earlier release recorded no more than the address.
    asked = isinstance(llm, Mapping) and provider_facts(str(llm.get("provider"))).is_model and bool(llm.get("base_url"))
    elsewhere = record.elsewhere or asked
    return replace(record, name=record.name or "run", config=config, pages=PAGES, elsewhere=elsewhere)


def _last_day(run: Path) -> str:
    timings = RunDirectory(run).read_timings()
    day = timings[-1].at[: len("YYYY-MM-DD")] if timings else ""
    if not day:
        place = f"{run}/timings.jsonl"
        raise ConfigError(
            "no line", place=place, expected="lines with the time of each slot", remedy="set --date YYYY-MM-DD"
        )
    return day


def _stage(run: RecordedRun, studies: Iterable[StudyDirectory]) -> dict[str, bytes]:
    """Return the files that are published of a run, by their place in it."""
    check_name(run.config.llm.name)
    directory, record = run.directory, _publishable(run.record)
    source = directory.path
    paths = [*source.glob("candidates/*"), *(source / name for name in RUN_FILES if name != NOTE)]
    known = list(studies)
    paths += [study.path / "scores.jsonl" for study in known]
    files = {path.relative_to(source).as_posix(): path.read_bytes() for path in paths if path.exists()}
    for name in run.config.code:
        for file, text in (directory.read_part(name) or {}).items():
            files[f"{PARTS}/{name}/{file}"] = text.encode()
    for study in known:  # as a replay of the bundle demands it, however it is spaced here
        files[f"studies/{study.path.name}/study.json"] = readable(plain_study(study.read())).encode()
    if "timings.jsonl" in files:  # without lines that a kill tore
        files["timings.jsonl"] = "".join(map(timing_text, directory.read_timings())).encode()
    if (run.record.pages, run.record.elsewhere) != (PAGES, record.elsewhere):  # by another release
        files["summary.md"] = summarise(replace(run, record=record)).encode()
    return {**files, **_note(source), "run.json": run_text(record).encode()}


def _note(source: Path) -> dict[str, bytes]:
    """Return what readers must know, where it can be shown to them."""
    return {NOTE: (source / NOTE).read_bytes()} if read_note(source) else {}


def _studies(chosen: Sequence[Path], run: RecordedRun, view: Progress) -> list[StudyDirectory]:
    """Choose the studies of a run: those that were named, or all that are finished."""
    every, digest = studies_of(run.directory.path), run.ledger.digest
    whole = [study for study in every if (record := study.read()).digest is not None and record.run == digest]
    if not chosen:
        for study in every:
            if study not in whole:
                view.say(f"study {study.path.name} is left out: it is not finished, or not about the run as it is")
        return whole
    by_path = {study.path.resolve(): study for study in whole}
    for path in chosen:
        if path.resolve() not in by_path:
            finished = ", ".join(str(study.path) for study in whole) or "none"
            raise RunError(str(path), expected=f"the directory of a finished study of {run.directory.path}: {finished}")
    return [by_path[resolved] for resolved in sorted({path.resolve() for path in chosen})]


def _members(staged: Opened, runs: Sequence[Rerun]) -> dict[str, bytes]:
    """Return the files of staged runs, those that were compared; a sweep's candidates are packed beside them."""
    folder = "run" if staged.jobs is None else SWEEP
    compared = {f"candidates/{name}" for name in runs[0].replayed.files} if staged.jobs is None else set()
    return {
        f"{folder}/{name}": data
        for name, data in files_below(staged.folder).items()
        if "candidates/" not in name or name in compared
    }


def _entries(staged: Opened, runs: Sequence[Rerun], read: Iterable[Path]) -> Iterator[Entry]:
    """Return the store entries that a replay needs; of a sweep its candidates' files, too, and no test predictions.

    Forty winners under 20 seeds make 50 MB of predictions, which no comparison of a sweep looks at.
    """
    entries = map(read_entry, read)
    yield from (entry for entry in entries if staged.jobs is None or entry.kind != KIND)
    if staged.jobs is None:
        return
    for folder, done in zip(staged.runs, runs, strict=True):
        for name in done.replayed.files:
            yield candidate_entry(folder.name, name, (folder / "candidates" / name).read_bytes().decode())


def _test_labels(staged: Opened, runs: Sequence[Rerun]) -> int:
    """Count the labels of test images among the entries (see `_entries`)."""
    if staged.jobs is not None:
        return 0
    kept = {
        row.kept.labels: study.record.data.counts[2]
        for study in runs[0].studies.values()
        for row in study.rows
        if isinstance(row, ScoreLine) and row.kept is not None
    }
    return sum(kept.values())


def _checked(entry: Entry) -> Entry:
    """Check the names of an answer's model: that which was asked, and that which the server gave."""
    for told in (entry.request, entry.answer) if entry.kind == "completions" else ():
        check_name(str(value_at(told, ("model",))))
    return entry


def _subject(staged: Opened, runs: Sequence[Rerun]) -> Subject:
    """Gather what the pages say of what is published."""
    jobs = () if staged.jobs is None else SweepDirectory(staged.folder).read().jobs
    return Subject(
        runs=tuple(done.run for done in runs),
        studies=tuple({name: study.digest for name, study in done.studies.items()} for done in runs),
        jobs=jobs,
        note=read_note(staged.folder),
    )


def _in_folder(folder: str, files: Mapping[str, bytes]) -> dict[str, bytes]:
    return {f"{folder}/{name}": content for name, content in files.items()}


def _papers(subject: Subject, terms: Terms, members: Iterable[str]) -> dict[str, bytes]:
    """Write what describes a bundle, the metadata last: it lists all others."""
    from tacevo.bundles.crate import metadata  # a part: only publishing needs it

    versions = subject.first.record.versions
    lock = _lock(versions)
    texts = {
        "README.md": readme(subject, has_lock=lock is not None),
        "LICENSE.txt": licence(terms),
        "CITATION.cff": citation(subject, terms),
        LOCK: _recorded_pins(versions) if lock is None else lock,
    }
    texts["ro-crate-metadata.json"] = metadata(subject, terms, [*members, *texts, MANIFEST])
    return {name: text.encode() for name, text in texts.items()}


def _lock(versions: Mapping[str, str]) -> str | None:
    """Return a pin of every package, from the lock files of this one, if it has them and they are what the run had.

    They lie in a checkout; an installed package has none.
    """
    locks = [path for name in (LOCK, "torch.lock") if (path := conf_root().parent / name).exists()]
    pins = [pin for path in locks for pin in re.findall(r"^\S+==\S+", path.read_text(encoding="utf-8"), re.MULTILINE)]
    known = {pin.lower().replace("_", "-") for pin in pins}
    whole = all(pin in known for pin in _pins(versions))
    return "".join(f"{pin}\n" for pin in sorted(pins, key=str.lower)) if whole else None


def _recorded_pins(versions: Mapping[str, str]) -> str:
    """Return a pin of each package whose version a run recorded, for an environment of which no lock file is known."""
    head = "# What the run recorded of its environment: the packages that may change a result. No others are known.\n"
    return head + "".join(f"{pin}\n" for pin in _pins(versions))


def _pins(versions: Mapping[str, str]) -> list[str]:
    """Write the recorded versions of packages as pins; tacevo itself comes from its clone."""
    had = {name: versions.get(name, "absent") for name in PACKAGES if name != "tacevo"}
    plain = {name: version.partition("+")[0] for name, version in had.items()}  # torch adds its build
    return sorted(f"{name}=={version}" for name, version in plain.items() if _VERSION.fullmatch(version))
