"""The functions that train, ask a model or write: the commands of these names, with their progress."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, overload

from tacevo.api.opening import open_run
from tacevo.api.pages import pages
from tacevo.api.replaying import extended
from tacevo.api.runs import Run, progress
from tacevo.api.studies import Study
from tacevo.api.sweeps import Sweep
from tacevo.bundles.open import opened
from tacevo.bundles.publish import publish as publish_bundle
from tacevo.bundles.readme import Terms
from tacevo.config.compose import compose, compose_noise, compose_study
from tacevo.config.conf_folder import check_experiment
from tacevo.config.given import compose_given
from tacevo.config.study import StudyStoreConfig
from tacevo.errors import ConfigError, RunError
from tacevo.parts.registry import needing_parts
from tacevo.runs.providers import check_temperature
from tacevo.runs.session import search as run_search
from tacevo.studies.given_run import record_given
from tacevo.studies.of_sweep import study_sweep
from tacevo.studies.study import Studied
from tacevo.studies.study import study as run_study
from tacevo.text import as_override, counted


@needing_parts()
def search(*overrides: str, quiet: bool = False) -> Run:
    """Run a search, or continue one that was stopped; the same call repeats a finished one in seconds.

    Args:
        overrides: as of `tacevo search`: `GROUP=CHOICE` or `KEY=VALUE`, such as `"experiment=demo", "seed=1"`.
        quiet: whether to show no progress on standard error.

    Raises:
        ConfigError: an override is wrong, has several values or is no `experiment=`; or settings do not go together.
        LLMError: the model gave no answers; what was answered is kept.
        RunError: another run lies in `run.dir`.
        KeyboardInterrupt: it was stopped; what was computed is kept, and the same call continues.
    """
    config = compose(overrides)
    check_experiment(overrides)
    check_temperature([override for override in overrides if override.startswith("ablation=")], config)
    with progress(quiet) as view:
        done = run_search(config, view)
    return open_run(done.directory)


@needing_parts()
def extend(run: Run | str | os.PathLike[str], *overrides: str, trust_parts: bool = False, quiet: bool = False) -> Run:
    """Search on from the end of a run, in a run directory of its own, once its records were compared.

    Args:
        run: a finished run, in a directory or a bundle, or one job of a sweep.
        overrides: as of `tacevo extend`, among them `"search.generations=30"`.
        trust_parts: whether parts that the run's user brought decide, by their recorded sources, confined.
        quiet: whether to show no progress on standard error.

    Raises:
        ConfigError: an override would make it another run, or not a longer one.
        DivergenceError: the run is not what its stores give; nothing was asked.
        RunError: it is a sweep; or it was made under other rules.
    """
    place = run.place if isinstance(run, Run) else opened(Path(run))
    if isinstance(run, Run) and place.digest is None:
        place = replace(place, entries=run.recorded.stores)
    with progress(quiet) as view:
        done = extended(place, overrides, view, trusts=trust_parts)
    return open_run(done.directory)


@overload
def study(
    run: Run | str | os.PathLike[str] | None = None, *other: str, quiet: bool = False, **settings: Any
) -> Study: ...
@overload
def study(run: Sweep, *other: str, quiet: bool = False, **settings: Any) -> Sweep: ...
@needing_parts()
def study(
    run: Run | Sweep | str | os.PathLike[str] | None = None, *other: str, quiet: bool = False, **settings: Any
) -> Study | Sweep:
    """Train a run's best networks and the baseline fully, with several seeds each, and test them.

    Args:
        run: a finished run in a directory; or an open sweep, whose finished jobs are studied and which is returned;
            None of given networks, `networks="mine"`, or a baseline alone, `task="force"`.
        other: settings of data, numerics and device that are not the run's, such as `"data.split_seed=7"`, of a sweep
            those of numerics and device; without a run all settings of the run that is made.
        quiet: whether to show no progress on standard error.
        settings: as of `tacevo study`, such as `elites=2, seeds=5, epochs=40`, and `arms=["none", "drift"]` of a sweep.

    Raises:
        ConfigError: a setting is wrong, or has several values; or the run is a bundle, which nothing is written into.
        RunError: the run is not finished; or trainings of the study failed, of a sweep's once all were tried.
    """
    if run is None:
        config, made, files = compose_given([*_texts(settings), *other])
        with progress(quiet) as view:
            done = run_study(replace(config, run=str(record_given(made, files, view))), view)
        return _study_of(done, config.store.root)
    if isinstance(run, Sweep):
        with progress(quiet) as view:
            studies, _ = study_sweep(_of_sweep(run), compose_study(_settings(settings, "sweep")), view, other)
        return _again(run, studies)
    given = compose_study(_settings(settings))
    with progress(quiet) as view:
        done = run_study(replace(given, run=str(_directory(run)), store=_stores(given.store, run)), view, other)
    return _study_of(done, given.store.root, run)


@overload
def noise(run: Run | str | os.PathLike[str], *, quiet: bool = False, **settings: Any) -> Study: ...
@overload
def noise(run: Sweep, *, quiet: bool = False, **settings: Any) -> Sweep: ...
@needing_parts()
def noise(run: Run | Sweep | str | os.PathLike[str], *, quiet: bool = False, **settings: Any) -> Study | Sweep:
    """Train a run's elites again as its search did, with other seeds, to see how much of each fitness was luck.

    Args:
        run: a finished run in a directory; or an open sweep, as of `study`.
        quiet: whether to show no progress on standard error.
        settings: as of `tacevo noise`, such as `elites=2, seeds=12`.

    Returns:
        The noise run, whose `reestimates` are the fitnesses under the other seeds.

    Raises:
        ConfigError: as `study`.
        RunError: as `study`.
    """
    from tacevo.studies.noise import estimate_noise, estimate_noise_of_sweep  # a room of its own, which may be missing

    if isinstance(run, Sweep):
        with progress(quiet) as view:
            studies, _ = estimate_noise_of_sweep(_of_sweep(run), compose_noise(_settings(settings, "sweep")), view)
        return _again(run, studies)
    given = compose_noise(_settings(settings))
    with progress(quiet) as view:
        done = estimate_noise(replace(given, run=str(_directory(run)), store=_stores(given.store, run)), view)
    return _study_of(done, given.store.root, run)


@needing_parts()
def publish(
    run: Run | Sweep | str | os.PathLike[str],
    target: str | os.PathLike[str],
    *,
    authors: str | Sequence[str] = (),
    licence: str = "CC-BY-4.0",
    date: str = "",
    sign: str | os.PathLike[str] | None = None,
    quiet: bool = False,
) -> str:
    """Replay a finished run or a sweep with its studies, and write all that belongs to it into one file.

    Args:
        run: the run or sweep, or its directory.
        target: the file to write, such as `mine.zip`; a bundle that stands there is replaced.
        authors: of the publication, one as a text; none is `anonymous`.
        licence: of what is published, an SPDX identifier.
        date: of publication, YYYY-MM-DD; the day on which the run ended if empty.
        sign: the file of an SSH key, with which the bundle digest is signed into a file beside the bundle.
        quiet: whether to show no progress on standard error.

    Returns:
        The digest of the bundle.

    Raises:
        DivergenceError: the run is not what its stores give.
        RunError: it is not finished.
        ConfigError: there is no such key, or it cannot sign.
    """
    terms = Terms(licence=licence, authors=(authors,) if isinstance(authors, str) else tuple(authors), published=date)
    with progress(quiet) as view:
        done = publish_bundle(
            _of_sweep(run) if isinstance(run, Sweep) else _directory(run),
            Path(target),
            terms=terms,
            make_pages=partial(pages, say=view.say),
            view=view,
            studies=(),
            store=None,
            key=None if sign is None else Path(sign),
        )
    return done.digest


def _of_sweep(sweep: Sweep) -> Path:
    """Return the directory of a sweep; nothing is written into a bundle."""
    if sweep.place.digest is not None:
        remedy = "`tacevo extend SWEEP.zip/JOB` goes on from one of its jobs"
        raise ConfigError("a published sweep", place=sweep.name, expected="a sweep in a directory", remedy=remedy)
    return sweep.place.folder


def _again(sweep: Sweep, studies: Sequence[Studied]) -> Sweep:
    """Open a sweep anew, with the studies that were just added to it."""
    for one in studies:
        _check_whole(one)
    return Sweep(sweep.name, sweep.place, sweep.store)


def _settings(settings: dict[str, Any], kind: str = "run") -> list[str]:
    """Write keyword arguments as overrides; the run is named afterwards, since its path may be any text."""
    return [f"{kind}=RUN", *_texts(settings)]


def _texts(settings: dict[str, Any]) -> list[str]:
    """Write keyword arguments as overrides."""
    words = {name: "null" if value is None else value for name, value in settings.items()}
    return [as_override(name, value) if isinstance(value, str) else f"{name}={value}" for name, value in words.items()]


def _stores(named: StudyStoreConfig, run: Run | str | os.PathLike[str]) -> StudyStoreConfig:
    """Return the stores that an open run has, such as those that `open` was told, unless others are named."""
    if named.root is not None or not isinstance(run, Run) or run.recorded.without_stores:
        return named
    return replace(named, root=str(run.recorded.stores))


def _directory(run: Run | str | os.PathLike[str]) -> Path:
    """Return the directory of a run; nothing is written into a bundle."""
    if not isinstance(run, Run):
        return Path(run)
    if run.place.digest is not None:
        raise ConfigError(
            "a published run", place=run.name, expected="a run in a directory", remedy="`tacevo extend` makes one"
        )
    return run.path


def _study_of(done: Studied, store: str | None, of: Run | str | os.PathLike[str] | None = None) -> Study:
    """Return a study that was just finished; an open run that it is of reads its studies again."""
    if isinstance(of, Run):
        of.forget()
    _check_whole(done)
    run = open_run(done.directory.parents[1], store=store)
    return next(study for study in run.studies if study.name == done.directory.name)


def _check_whole(done: Studied) -> None:
    """Check that no training of a study failed."""
    if done.failed:
        raise RunError(
            f"{counted(len(done.failed), 'training')} that failed: {done.failed[0]}",
            place=str(done.directory),
            expected="a training of every network with every seed",
            remedy="raise seconds= or memory_mib=, or lower elites=",
        )
