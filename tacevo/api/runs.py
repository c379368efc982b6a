"""A finished run: its candidates, elites, networks, studies, tables and figures."""

from __future__ import annotations

import html
import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from analysis.report.collection import Collection, collection_of, read_studies, tables_of
from analysis.report.outputs import outputs
from analysis.runs import dynamics
from analysis.studies.reestimates import losses_by_source
from analysis.table import Table as Rows
from tacevo.api import frames, trusted_network
from tacevo.api.replaying import digest_of, replay
from tacevo.api.studies import Studies, Study, check_read
from tacevo.api.tables import Named, Table
from tacevo.bundles.open import Opened, check_walls
from tacevo.config.schema import RunConfig
from tacevo.errors import CacheMissError, ConfigError, RunError
from tacevo.evolution.lines import CandidateLine
from tacevo.gate.imports import with_imports
from tacevo.parts.registry import needing_parts
from tacevo.results.run import RecordedRun
from tacevo.results.summary import summarise
from tacevo.runs.profiles import recall_profiles
from tacevo.runs.progress import Progress
from tacevo.text import listed, nearest
from tacevo.typed import convert

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure
    from torch import nn

T = TypeVar("T")

Draw = Callable[[], "Figure"]


class Run:
    """A finished run, whose ledger, archives and digest were compared with each other when it was opened."""

    def __init__(self, place: Opened, recorded: RecordedRun) -> None:
        #: The place of the run: a directory, a bundle or a job of one.
        self.place = place
        #: The records of the run: run.json, the ledger, settings for this machine.
        self.recorded = recorded

    @property
    def path(self) -> Path:
        """The directory of the run."""
        return self.recorded.path

    @property
    def name(self) -> str:
        """The name of the run's directory."""
        return self.recorded.name

    @property
    def digest(self) -> str:
        """The last hash of its ledger, which stands for every decision of the search; 64 hexadecimal digits."""
        return self.recorded.digest

    @property
    def config(self) -> RunConfig:
        """The run's recorded settings, such as `run.config.search.generations`; `store.root` as it was found."""
        return self.recorded.config

    @property
    def versions(self) -> Mapping[str, str]:
        """The versions of Python and of the packages that made the run, by name."""
        return self.recorded.record.versions

    @property
    def summary(self) -> str:
        """The results in words and tables, in Markdown, as `tacevo show` begins."""
        return summarise(self.recorded)

    @property
    def candidates(self) -> pd.DataFrame:
        """A row a candidate in the order of the ledger, by id; columns: docs/python.md."""
        known, elites = self.recorded.fitness, {elite.id for elite in self.recorded.elites}
        rows = (self._candidate(line, known, elites) for line in self.recorded.candidates)
        return frames.frame(rows, frames.CANDIDATES, index="id")

    @property
    def generations(self) -> pd.DataFrame:
        """A row a generation, from 0 (the baseline and the initial networks); columns: docs/python.md."""
        generations = dynamics.progress(self.recorded)
        if not outputs(ours=True).has("pareto"):
            return generations
        from analysis.runs.pareto import with_hypervolumes  # a part, which may not be installed

        return with_hypervolumes(self.recorded, generations)

    @property
    def elites(self) -> pd.DataFrame:
        """The network archive by niche, the best fitness first; columns: docs/python.md."""
        lines = {line.id: line for line in self.recorded.candidates}
        rows = ({**asdict(lines[elite.id]), **asdict(elite)} for elite in self.recorded.ranked())
        return frames.frame(rows, frames.ELITES, index="niche")

    @property
    def prompts(self) -> pd.DataFrame:
        """The prompt archive by niche; without rows where the search kept none; columns: docs/python.md."""
        return frames.frame(map(asdict, self.recorded.prompt_trials), frames.PROMPTS, index="niche")

    @needing_parts()
    def pareto(self, objectives: Sequence[str | pd.Series[Any]] = ("fitness", "flops")) -> pd.DataFrame:
        """Return the front: the trained candidates that no other one beats in all objectives; columns: docs/python.md.

        The fitness of a candidate that a study or a noise run trained again is the median of those seeds; the column
        `estimate` says what each is. The lowest first objective comes first; of equal candidates the first one counts.

        Args:
            objectives: lower is better; each `fitness`, `parameters` or `flops`, or a Series by id of a name of its
                own, such as measured milliseconds. That becomes a column, and candidates without a value are left out.

        Raises:
            ConfigError: fewer than two objectives, or not such ones.
            RunError: `fitness` is among the objectives, a study or a noise run trained candidates again, and the stores
                do not have these trainings.
        """
        from analysis.runs.pareto import beside_costs, on_front  # a part, which may not be installed

        if any(isinstance(one, str) and one == "fitness" for one in objectives):
            check_read(self.collection.unread.values())
        known = beside_costs(self.recorded, losses_by_source(self.collection.reestimates))
        return on_front(*_with_objectives(known, objectives))

    def source(self, candidate: str) -> str:
        """Return the source of an admitted candidate, with the imports that the sandbox gave it: it runs as a file.

        Raises:
            ConfigError: the run has no such candidate, or the gate rejected it.
            RunError: the file is not what the ledger has the hash of.
        """
        return with_imports(self._read_source(candidate))

    def network(self, candidate: str, *, trust: bool = False) -> nn.Module:
        """Build a candidate's network in this process, with fresh weights that follow from `torch.manual_seed`.

        It maps float32 images `(N, channels, size, size)` to float32 `(N, outputs)`.

        Args:
            candidate: its id.
            trust: that you have read its source: a model wrote it, and no sandbox confines it here.

        Raises:
            ConfigError: without `trust=True`; or as `source`.
            RunError: as `source`.
        """
        if not trust:
            raise ConfigError(
                "trust=False",
                place=f"network({candidate!r})",
                expected="trust=True: the code of the candidate runs in this process, where nothing confines it",
                remedy=f"read run.source({candidate!r}) first",
            )
        source = self._read_source(candidate)
        return trusted_network.build(source, f"candidate_{candidate}", self.recorded.record.task.contract)

    @needing_parts()
    def export(
        self,
        candidate: str,
        directory: str | os.PathLike[str],
        *other: str,
        retrained: bool = False,
        quiet: bool = False,
        **settings: Any,
    ) -> Path:
        """Train a candidate again in the sandbox, and write it as a directory that needs no tacevo (docs/export.md).

        Args:
            candidate: its id.
            directory: which must not exist.
            other: `"data.root=DIR"`, where the data set of the run lies, if it was moved.
            retrained: whether a training that is not recorded, or goes otherwise than recorded, is an error.
            quiet: whether to show no progress on standard error.
            settings: as of `tacevo export`, such as `seeds=3, like="search"`.

        Returns:
            The directory.

        Raises:
            ConfigError: a setting is wrong, the directory exists, or packages are missing; or as `source`.
            DataError: the data set of the run is missing.
            DivergenceError: with `retrained`, a training is not as recorded; or a study of it does not follow from the
                stores.
            RunError: with `retrained`, one is not recorded; or the network cannot be trained or written so.
        """
        from tacevo.export.directory import export as write_export  # composes the recipe of a study, with Hydra
        from tacevo.export.trainings import ExportSettings

        given = convert(ExportSettings, settings, place="export", error=ConfigError)
        root = self._moved_to(other)
        self._read_source(candidate)
        check_walls(self.place)
        line = next(line for line in self.recorded.candidates if line.id == candidate)
        with progress(quiet) as view:
            bundle = self.place.digest
            write_export(
                self.recorded, line, Path(directory), given, bundle=bundle, retrained=retrained, view=view, root=root
            )
        return Path(directory)

    @cached_property
    def studies(self) -> Studies:
        """The run's whole studies and noise runs: first those on the run's data, of these first on its device.

        Choices (`Study.is_choice`) come last.
        Printed, they say why others were left out.
        """
        collection = self.collection
        compared = {one.name: one for one in collection.studies}
        again = {one.name: one for one in collection.reestimates}
        shown = compared.keys() | again.keys()
        known = [one for one in collection.finished if one.record.is_choice or one.path.name in shown]
        known.sort(
            key=lambda one: (
                *(one.record.is_choice, bool(one.record.other_data), bool(one.record.other_device)),
                one.path.name,
            )
        )
        studies = Studies(
            Study(
                self.recorded,
                one,
                compared.get(one.path.name),
                again.get(one.path.name),
                tables=self._tables_of,
                figures=self._figures_of,
                unread=collection.unread.get(one.path.name, ""),
                left_out="; ".join(reason for reason in collection.left_out if one.path.name in reason),
            )
            for one in known
        )
        studies.left_out = collection.left_out
        return studies

    @cached_property
    def tables(self) -> Mapping[str, Table]:
        """Every table of `tacevo tables` by name: `gate`, `prompts`; of a study `verdicts`, `STUDY/verdicts`."""
        tables, missing = self.all_tables()
        return self._named({table.name: Table(table) for table in tables}, "run.tables", missing)

    @cached_property
    @needing_parts()
    def figures(self) -> Mapping[str, Draw]:
        """Every figure of `tacevo figures` by name, as `fitness`; each is a function that draws one.

        `samples` raises a DataError where the images of the run are not at hand; simulated ones are made again.
        """
        from analysis.report.figure_list import pictures_of, with_others  # Matplotlib takes a second to import

        missing: list[str] = []
        brought = outputs().figures(self.collection, missing.append)
        pictures = with_others(pictures_of(self.collection), brought, missing.append)
        drawn = {picture.name: picture.draw for picture in pictures}
        return self._named({"samples": self._draw_samples, **drawn}, "run.figures", missing)

    @property
    def left_out(self) -> tuple[str, ...]:
        """The reasons why studies of the run, or their comparisons or re-estimates, are not shown, a sentence each."""
        return (*self.collection.left_out, *self.collection.remarks)

    @needing_parts()
    def replay(self, *, trust_parts: bool = False, quiet: bool = False) -> str:
        """Run the search and its studies again from their stores, without model or training; compare every line.

        Of a bundle, everything that its records give is compared: tables, summary, the use of every store entry. What
        parts decided that its user brought is recalled; with `trust_parts`, their recorded sources decide again, in
        confined processes, and are compared.

        Returns:
            The digest.

        Raises:
            DivergenceError: the first difference.
            CacheMissError: a store lacks an answer.
            BundleError: the records of a bundle do not suit each other.
        """
        with progress(quiet) as view:
            return digest_of(self.place, replay(self.place, self.recorded.config.store.root, view, trusts=trust_parts))

    def forget(self) -> None:
        """Read its studies again when they are next asked for: one was made."""
        for name in ("collection", "studies", "tables", "figures"):
            self.__dict__.pop(name, None)

    def all_tables(self) -> tuple[tuple[Rows, ...], list[str]]:
        """Return its tables, and why others are missing, a sentence each."""
        known = outputs()
        try:
            profiles, missing = recall_profiles(self.recorded), list(known.missing.values())
        except (CacheMissError, RunError) as error:
            profiles, missing = None, [*known.missing.values(), f"no table of motifs: {error}"]
        return tables_of(self.collection, profiles, known, missing.append), missing

    def __repr__(self) -> str:
        """Name it, and say what it lacks; once its studies were read, which takes seconds, also why some are out."""
        count, read = len(self.recorded.candidates), self.__dict__.get("collection")
        facts = f"run {self.name}: {self.recorded.task}, {count} candidates, digest {self.digest[:12]}"
        refused = [] if read is None else [f"left out: {reason}" for reason in read.left_out]
        return "; ".join([f"<{facts}", *self._lacking(), *refused]) + ">"

    def _repr_html_(self) -> str:
        facts = {
            "task": self.recorded.task,
            "answers by": self.recorded.model,
            "candidates": f"{len(self.recorded.candidates)}, {len(self.recorded.trained)} trained",
            "elites": f"{len(self.recorded.elites)} of {self.recorded.places}",
            "digest": self.digest,
        } | ({"missing": "; ".join(self._lacking())} if self._lacking() else {})
        rows = "".join(f"<tr><th>{name}</th><td>{html.escape(str(value))}</td></tr>" for name, value in facts.items())
        return f"<p>run {html.escape(self.name)}</p><table>{rows}</table>{self.elites.head(10).to_html(na_rep='')}"

    @cached_property
    def collection(self) -> Collection:
        """The records of the run with its studies and what their test images say.

        Raises:
            RunError: its directory is not there any more, as after `os.chdir` where it was opened by a relative path.
        """
        if not (self.path / "run.json").exists():
            got, remedy = "a path that does not exist", "open the run again"
            raise RunError(got, place=str(self.path), expected="the directory of the run", remedy=remedy)
        return collection_of(self.recorded, read_studies(self.recorded), outputs())

    def _lacking(self) -> list[str]:
        """Say that its stores are not there, which its studies, tables and figures need."""
        return [self.recorded.without_stores] if self.recorded.without_stores else []

    def _named(self, values: Mapping[str, T], what: str, missing: Sequence[str] = ()) -> Named[T]:
        """Add the plain names of a study's: `verdicts` beside `STUDY/verdicts`, of the first study that has one."""
        named = dict(values)
        for study in self.studies:
            below = _below(study.name, values, what)
            named |= {name: value for name, value in below.items() if name not in named}
        return Named(named, what, self._lacking() or [*self.left_out, *missing])

    @needing_parts()
    def _draw_samples(self) -> Figure:
        from rich.console import Console

        from tacevo.runs.data_check import samples_of_run

        return samples_of_run(self.recorded.with_data, self.recorded.facts, Console(stderr=True))

    def _tables_of(self, study: str) -> Mapping[str, Table]:
        return _below(study, self.tables, "study.tables", self._lacking_of(study))

    def _figures_of(self, study: str) -> Mapping[str, Draw]:
        return _below(study, self.figures, "study.figures", self._lacking_of(study))

    def _lacking_of(self, study: str) -> list[str]:
        return self._lacking() or [reason for reason in self.left_out if study in reason]

    def _moved_to(self, other: Sequence[str]) -> str | None:
        """Return the place of the data set that a user names, in place of the run's."""
        if not other:
            return None
        key, _, root = other[0].partition("=")
        if len(other) > 1 or key != "data.root" or not root:
            expected = "data.root=DIR alone, once: all other settings of data are the run's"
            raise ConfigError(listed(other), place="export", expected=expected)
        if self.config.data.root is None:
            source = f"data={self.config.data.source}"
            raise ConfigError(other[0], place="data.root", expected=f"no value with {source}, which reads no files")
        return root

    def _read_source(self, candidate: str) -> str:
        sources = {line.id: line.source for line in self.recorded.candidates if line.source is not None}
        if candidate not in sources:
            is_there = any(line.id == candidate for line in self.recorded.candidates)
            raise ConfigError(
                f"{candidate!r}, which the gate rejected" if is_there else repr(candidate),
                place="candidate",
                expected=f"the id of an admitted candidate of {self.name}, such as g02s03",
                remedy=nearest(candidate, sources, "run.candidates has all"),
            )
        return self.recorded.directory.read_source(candidate, str(sources[candidate]))

    def _candidate(self, line: CandidateLine, known: Mapping[str, float], elites: set[str]) -> dict[str, Any]:
        spent = self.recorded.spent.get(line.id)
        return {
            **asdict(line),
            "instruction": None if line.prompt is None else self.recorded.instructions[line.prompt],
            "temperature": line.sent_temperature,
            "carrier": None if line.request is None else line.carrier,
            "outcome": _outcome(line),
            "repairs": len(line.repairs),
            "fitness": known.get(line.id),
            "recorded_fitness": line.fitness,
            "is_elite": line.id in elites,
            "usd": None if spent is None or spent.unpriced else spent.usd,
            "cpu_seconds": self.recorded.cpu_seconds.get(line.id),
        }


def remarks_on(run: Run) -> list[str]:
    """List the settings that were not sent, the studies that were left out, and how to make a first one."""
    collection = run.collection
    remarks = [
        *collection.run.on_sampling,
        *(f"left out: {reason}" for reason in collection.left_out),
        *collection.remarks,
    ]
    is_looked_up = run.config.data.facts.is_looked_up  # nothing of it can be studied
    if not collection.studies and not collection.left_out and not is_looked_up:
        make = f"`tacevo study {shlex.quote(str(run.path))}` makes one, with its tables and figures"
        is_bundle = run.place.digest is not None
        remarks.append("no study: it was published without one" if is_bundle else f"no finished study yet: {make}")
    return remarks


def _below(study: str, named: Mapping[str, T], what: str, lacking: Sequence[str] = ()) -> Named[T]:
    begin = f"{study}/"
    own = {name.removeprefix(begin): value for name, value in named.items() if name.startswith(begin)}
    return Named(own, what, lacking)


def _with_objectives(known: pd.DataFrame, objectives: Sequence[str | pd.Series[Any]]) -> tuple[pd.DataFrame, list[str]]:
    """Return a frame of trained candidates with the objectives among its columns, and these by name."""
    own, names = ("fitness", "parameters", "flops"), []
    for one in objectives:
        if isinstance(one, str):
            names += [one] if one in own else []
        elif isinstance(one.name, str) and one.name not in known.columns and one.index.is_unique:
            foreign = [name for name in one.index if name not in known.index]
            if foreign or one.dtype.kind not in "iuf":
                got = f"values of {listed(map(str, foreign), most=3)}" if foreign else f"values of dtype {one.dtype}"
                expected = "numbers, each of a candidate that was trained"
                raise ConfigError(got, place=f"objectives, {one.name}", expected=expected)
            known, names = known.assign(**{one.name: one.astype("float64")}), [*names, one.name]
    if len(set(names)) < max(2, len(objectives)):
        raise ConfigError(
            listed(one if isinstance(one, str) else f"a Series {one.name!r}" for one in objectives),
            place="objectives",
            expected=f"two or more, each once: of {listed(own)}, or Series of other names, each id once",
        )
    return known, names


def _outcome(line: CandidateLine) -> str:
    """Return what became of a candidate: `rejected` by gate or training, `skipped`, or what the archive did with it."""
    if line.status is None:
        return "skipped" if line.skipped else "rejected"
    return {"new": "new", "improved": "improved", "rejected": "not_kept"}[line.status.value]


def progress(quiet: bool) -> Progress:
    """Return what shows how far work is, on standard error, or nothing."""
    from rich.console import Console

    return Progress(Console(quiet=True) if quiet else None)
