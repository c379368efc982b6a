"""The files of a study, in `RUN/studies/<name>/`, readable with `ls` and `cat`.

study.json     what was studied, under which recipe, versions and machine; the digest once it is finished
scores.jsonl   a header, then a line for each network and seed in a fixed order, sealed as a ledger is

Both are written whole, so that several processes may end the same study at once: they write equal bytes.
"""

import contextlib
import math
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from statistics import median
from typing import Any

from tacevo.choices import ChosenBy
from tacevo.errors import RunError
from tacevo.records import Json, to_json, written
from tacevo.results.study_lines import SCHEMA, Design, Row, ScoreLine, StudyHeader, StudyRecord, study_line_kind
from tacevo.storage.canonical import content_hash, readable
from tacevo.storage.files import is_in_use, remove_leftovers, write_durably
from tacevo.storage.ledger import Ledger, Sealed, read_lines, sealed_text
from tacevo.storage.sweep_directory import Retraining
from tacevo.text import as_overrides, counted, listed
from tacevo.typed import parse

#: The names that `study_names` returns, as a regular expression.
NAME = r"(?:elites|networks|noise|choice)\d+-seeds\d+-epochs\d+-(?:[A-Za-z0-9._-]+-)?[0-9a-f]{8}"

#: The most characters of a directory's name for the settings in which a study differs from its run: today's limit, then
#: that of earlier releases.
_LONGEST_WHERE = (80, 40)

#: The most scores that may be missing before a study is refused for their number alone.
_MOST_MISSING = 1_000


@dataclass(frozen=True, slots=True, kw_only=True)
class FinishedStudy:
    """A study with its scores, whose hashes were checked; `read_finished` compares them with study.json, too."""

    path: Path
    #: The content of study.json.
    record: StudyRecord
    #: The first line of the scores.
    header: StudyHeader
    #: The scores, in the order of networks and seeds.
    rows: tuple[Row, ...]
    #: The hashes of the header and of each row.
    hashes: tuple[str, ...]

    @property
    def digest(self) -> str:
        """The last hash, which stands for all scores."""
        return self.hashes[-1]

    def compare(self, header: StudyHeader, rows: Sequence[Row]) -> str:
        """Compare with computed scores; return the digest of these.

        Raises:
            DivergenceError: they differ; the message names the row.
        """
        ledger = Ledger(Sealed((self.header, *self.rows), self.hashes))
        for line in (header, *rows):
            ledger.commit(line)
        return ledger.digest


class StudyDirectory:
    """Writes and reads the files of one study; the directory is made when something is written."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def scores(self) -> Path:
        """The path of the scores."""
        return self.path / "scores.jsonl"

    @property
    def is_finished(self) -> bool:
        """True where it has scores and a digest; whether these suit each other is not asked."""
        with contextlib.suppress(RunError):
            return self.scores.exists() and self.read().digest is not None
        return False

    @property
    def is_busy(self) -> bool:
        """True while a process is at work on the study."""
        return is_in_use(self.path)

    @property
    def _remedy(self) -> str:
        return f"delete {self.path}; `tacevo study` or `tacevo noise`, which made it, writes it again from the store"

    def begin(self, header: StudyHeader, **circumstances: Any) -> None:
        """Write study.json, unless it describes this very study already, whatever its circumstances.

        These are the fields of a `StudyRecord` that do not decide the scores: scale, units, versions and machine.
        """
        remove_leftovers(self.path)
        with contextlib.suppress(RunError):
            if not misfits(self.read(), header):
                return
        design = {field.name: getattr(header, field.name) for field in fields(Design)}
        self._write(StudyRecord(schema=SCHEMA, name=self.path.name, **design, **circumstances, digest=None))

    def finish(self, header: StudyHeader, rows: Sequence[Row]) -> str:
        """Write the scores, or compare them with those that stand here; return the digest.

        Raises:
            DivergenceError: the study was finished with other scores; the message names the row.
            RunError: the scores that stand here were damaged or edited.
        """
        if self.scores.exists():
            digest = self.read_scores().compare(header, rows)
        else:
            text, digest = sealed_text([header, *rows])
            write_durably(self.scores, text)
        self._write(replace(self.read(), digest=digest))
        return digest

    def read(self) -> StudyRecord:
        """Read study.json.

        Raises:
            RunError: it is missing, damaged or of another layout.
        """
        path = self.path / "study.json"
        text = path.read_bytes() if path.exists() else b""
        return parse(StudyRecord, text, place=str(path), error=RunError, remedy=self._remedy)

    def read_scores(self, record: StudyRecord | None = None) -> FinishedStudy:
        """Read a study with its scores, checked line by line; `record` is its study.json where that was read before.

        Raises:
            RunError: the study is not finished, or a line was damaged or edited; the message names network and seed.
        """
        try:
            sealed: Sealed[StudyHeader | Row] = read_lines(self.scores, study_line_kind, _row)
        except RunError as error:
            error.remedy = self._remedy
            raise
        headers = [line for line in sealed.lines if isinstance(line, StudyHeader)]
        rows = tuple(line for line in sealed.lines if not isinstance(line, StudyHeader))
        if not headers or not rows or sealed.lines != (headers[0], *rows):
            raise RunError(
                counted(len(rows), "score"),
                place=str(self.scores),
                expected="a header, then scores",
                remedy=self._remedy,
            )
        # What is missing is named by who reads the rows, unless a forged header makes that a list without end.
        if (wanted := len(headers[0].networks) * headers[0].seeds) > len(rows) + _MOST_MISSING:
            expected = f"{wanted} scores, by its header"
            raise RunError(str(len(rows)), place=str(self.scores), expected=expected, remedy=self._remedy)
        record = record or self.read()
        return FinishedStudy(path=self.path, record=record, header=headers[0], rows=rows, hashes=sealed.hashes)

    def read_finished(self) -> FinishedStudy:
        """Read study.json and the scores, and compare their digests; for what uses them without a replay.

        Raises:
            RunError: as `read_scores`, or a process is at work on it, or the digests differ.
        """
        record = self.read()
        if not self.scores.exists():
            got, remedy = "one that was interrupted", _continues(record)
            if self.is_busy:
                got, remedy = "one that is still running", "wait for it"
            trainings = counted(len(record.networks) * record.seeds, "training")
            raise RunError(got, place=str(self.path), expected=f"a finished study, of {trainings}", remedy=remedy)
        study = self.read_scores(record)
        if record.digest != study.digest:
            raise RunError(
                "null" if record.digest is None else record.digest,
                place=f"{self.path}/study.json, digest",
                expected=f"{study.digest}, with which scores.jsonl ends",
                remedy=_continues(record),
            )
        return study

    def _write(self, study: StudyRecord) -> None:
        write_durably(self.path / "study.json", readable(plain_study(study)))


def _continues(study: StudyRecord) -> str:
    """Name the command that goes on with a study; what else was set is not named where it is mostly the default."""
    settings = {"elites": len(study.networks) - 1, "seeds": study.seeds}
    if study.name.startswith("networks"):  # which were given, and all of them are studied
        del settings["elites"]
    if study.validated:
        settings["elites"] = study.validated
    if study.is_choice:  # the study that follows has seeds, which nobody knows yet
        del settings["seeds"]
    if not study.is_noise:
        settings["epochs"] = study.recipe.epochs
    words = [f"{key}={value}" for key, value in settings.items()]
    choose = ChosenBy.validated if study.is_choice else study.choose
    words += [f"choose={choose}"] if choose is not ChosenBy.fitness else []
    other = [*((f"data.{name}", value) for name, value in study.other_data), *study.other_device]
    words += as_overrides(other)
    command = "noise" if study.is_noise else "study"
    return f"`tacevo {command} RUN {shlex.join(words)}`, with what else was set, continues it; or delete it"


def plain_study(study: StudyRecord) -> dict[str, Json]:
    """Return what study.json holds, as JSON in its order."""
    return {**to_json(study), "recipe": written(study.recipe)}


def study_names(header: StudyHeader, *, searched: bool) -> tuple[str, ...]:
    """Name the directory of a study after what it is, as `elites4-seeds20-epochs50-<hash>`; today's name first.

    Args:
        header: of the study.
        searched: whether its run searched; the networks of other runs were given, which earlier releases called elites.
    """
    kinds: tuple[str, ...] = ("elites",) if searched else ("networks", "elites")
    if header.terms is None:
        kinds = ("choice",) if header.is_choice else ("noise",)
    where = f"{header.where}, {header.device}" if header.other_device else header.where
    where = re.sub(r"[^A-Za-z0-9._]+", "-", where).lstrip("-")
    size = f"{len(header.networks) - 1}-seeds{header.seeds}-epochs{header.recipe.epochs}"
    words = dict.fromkeys(where[:longest].strip("-") for longest in _LONGEST_WHERE)
    ends = ["-".join(part for part in (size, word, content_hash(written(header))[:8]) if part) for word in words]
    return tuple(f"{kind}{end}" for end in ends for kind in kinds)


def find_study(run: Path, header: StudyHeader, *, searched: bool) -> StudyDirectory:
    """Return the directory of a study in that of its run: one of an earlier name where it was begun under that."""
    paths = [run / "studies" / name for name in study_names(header, searched=searched)]
    return StudyDirectory(next((path for path in paths if path.exists()), paths[0]))


def studies_of(run: Path) -> list[StudyDirectory]:
    """List the studies of a run, finished or not, by name."""
    return [StudyDirectory(path.parent) for path in sorted(run.glob("studies/*/study.json"))]


def misfits(study: StudyRecord, header: StudyHeader) -> list[str]:
    """List the fields in which a study.json and a header differ."""
    return [field.name for field in fields(Design) if getattr(study, field.name) != getattr(header, field.name)]


def is_stated(study: Design, retraining: Retraining) -> bool:
    """Return whether a study tests networks of a job as its sweep states, however many; of the chosen one, of how many.

    One on other data than the run's is never meant: jobs are compared on their own.
    """
    settings = replace(
        retraining,
        elites=study.validated or retraining.elites,
        seeds=study.seeds,
        epochs=study.recipe.epochs,
        choose=study.choose,
        other_device=study.other_device,
    )
    return study.terms is not None and not study.other_data and settings == retraining


def _row(lines: Sequence[StudyHeader | Row]) -> str:
    """Name the row behind some lines: networks one after the other, each with all seeds."""
    header = lines[0] if lines else None
    if isinstance(header, StudyHeader) and len(lines) <= len(header.networks) * header.seeds:
        network, seed = divmod(len(lines) - 1, header.seeds)
        return f"{header.networks[network].name}, seed {seed}"
    return f"line {len(lines) + 1}" if lines else "the header"


def medians_of(directory: StudyDirectory) -> dict[str, float]:
    """Return the median validation loss of each network of a finished study, by id; none where a training failed."""
    losses: dict[str, list[float]] = {}
    for row in directory.read_finished().rows:
        losses.setdefault(row.id, []).append(row.validation_loss if isinstance(row, ScoreLine) else math.inf)
    return {name: median(values) for name, values in losses.items() if max(values) < math.inf}


def estimates_of(run: Path, study: Design) -> dict[str, float]:
    """Return the losses that the elites of a study were chosen by, by id, where these are not their recorded fitness.

    Of a noise run that is the median over its seeds; of a choice, the lowest validation loss of its one training. A
    network is left out where one of its trainings failed.

    Args:
        run: its directory.
        study: the study, which names what chose by its digest.

    Raises:
        RunError: as `chooser_of`.
    """
    return medians_of(chooser_of(run, study))


def chooser_of(run: Path, study: Design) -> StudyDirectory:
    """Find the noise run, or the choice, that the elites of a study were chosen by.

    Raises:
        RunError: the run does not have that, or it was edited; or it is nothing that such a study is chosen by.
    """
    for directory in studies_of(run):
        if (record := directory.read()).digest == study.chosen_by:
            _check_choosing(record, study, str(directory.path))
            return directory
    what, again = ("choice", "tacevo study") if study.validated else ("noise run", "tacevo noise")
    raise RunError(
        f"studies of the digests {listed(str(each.read().digest)[:12] for each in studies_of(run))}",
        place=f"{run}/studies",
        expected=f"the {what} {study.chosen_by[:12]} that the elites of a study were chosen by",
        remedy=f"`{again}` with its settings makes it again; of a bundle, publish both",
    )


def _check_choosing(record: StudyRecord, study: Design, place: str) -> None:
    """Check that a record may choose the elites of a study: about the same run, and by seeds that do not test."""
    wanted: dict[str, object] = {"run": study.run, "terms": None, "validated": study.validated, "other_data": ()}
    if study.validated:
        alike = ("recipe", "numerics", "device", "other_device")
        wanted |= {"seeds": 1} | {name: getattr(study, name) for name in alike}
    for name, value in wanted.items():
        if (got := getattr(record, name)) != value:
            what = "the choice" if study.validated else "a noise run"
            expected = f"{value}, as of {what} that the elites of such a study are chosen by"
            raise RunError(f"{got}", place=f"{place}/study.json, {name}", expected=expected)
