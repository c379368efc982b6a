"""The files that describe a published run or sweep to people: README, licence and citation; pure."""

import contextlib
import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from string import Template

import yaml
from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression

from tacevo.choices import SimulatedSensor
from tacevo.config.schema import RunConfig
from tacevo.errors import ConfigError
from tacevo.results.grouped import in_groups
from tacevo.results.run import RecordedRun
from tacevo.storage.notes import HEADING
from tacevo.storage.sweep_directory import Job, sweep_digest
from tacevo.text import as_code, counted, in_markdown, on_a_line

#: One licence that may stand in https://spdx.org/licenses, where no LicenseRef- does.
_SPDX = re.compile(r"(?!LicenseRef-)[A-Za-z0-9][A-Za-z0-9.+-]*")

#: The settings that a simulated data set follows from.
_SIMULATED = ("images", "image_size", "seed", "sensor_seed", "light", "spacings_mm")


def _is_spdx(licence: str) -> bool:
    """Return whether this is the identifier of a licence as SPDX spells it."""
    with contextlib.suppress(InvalidLicenseExpression):
        return _SPDX.fullmatch(licence) is not None and canonicalize_license_expression(licence) == licence
    return False


@dataclass(frozen=True, slots=True, kw_only=True)
class Terms:
    """The terms under which a run is published, and its publishers."""

    #: SPDX identifier of the bundle's own licence; the code's is Apache-2.0.
    licence: str
    authors: tuple[str, ...]
    #: The day of publication as YYYY-MM-DD; empty for the day on which the run ended.
    published: str

    def __post_init__(self) -> None:
        """Check what the user wrote."""
        if not _is_spdx(self.licence):
            raise ConfigError(repr(self.licence), place="--license", expected="an SPDX identifier such as CC-BY-4.0")
        if not all(author.isprintable() and author.strip() for author in self.authors):
            raise ConfigError(f"{list(self.authors)}", place="--author", expected="a name")
        try:
            sound = not self.published or date.fromisoformat(self.published).isoformat() == self.published
        except ValueError:
            sound = False
        if not sound:
            raise ConfigError(repr(self.published), place="--date", expected="a day as YYYY-MM-DD")

    @property
    def licence_address(self) -> str:
        """The address of the licence's text."""
        return f"https://spdx.org/licenses/{self.licence}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """The run or sweep that is published."""

    #: The run, or a sweep's runs in the order of its jobs.
    runs: tuple[RecordedRun, ...]
    #: Digest of each study, by name, for each run.
    studies: tuple[Mapping[str, str], ...]
    #: The jobs of a sweep; empty for a run.
    jobs: tuple[Job, ...] = ()
    #: The paragraphs of what its makers want readers to know.
    note: tuple[str, ...] = ()

    @property
    def first(self) -> RecordedRun:
        """The first run, which stands for all where a sweep's runs agree."""
        return self.runs[0]

    @property
    def what(self) -> str:
        """Call it what it is."""
        return "sweep" if self.jobs else "run"

    @property
    def digest(self) -> str:
        """The digest of the run's ledger, or of the sweep."""
        if not self.jobs:
            return self.first.ledger.digest
        return sweep_digest({job.name: run.ledger.digest for job, run in zip(self.jobs, self.runs, strict=True)})

    @property
    def folder(self) -> str:
        """The directory of one of its runs in the bundle, as people are told."""
        return "sweep/JOB" if self.jobs else "run"

    @property
    def title(self) -> str:
        """Give its title in a line."""
        task = self.first.record.task.name
        if self.jobs:
            return f"TacEvo sweep of {counted(len(self.jobs), 'run')}: architecture searches, task {task}"
        what = "architecture search" if self.first.answered else "given networks"
        return f"TacEvo run {self.first.record.name}: {what}, task {task}"

    @property
    def description(self) -> str:
        """Say in a few sentences what it is, and what answered."""
        count, candidates = sum(map(len, self.studies)), sum(len(run.candidates) for run in self.runs)
        studies = "1 study" if count == 1 else f"{count} studies"
        sizes = f"{counted(candidates, 'candidate')}, {studies}"
        answers = dict.fromkeys(map(origin_of_answers, self.runs))
        data = dict.fromkeys(origin_of_data(run.config) for run in self.runs)
        if self.jobs:
            arms = ", ".join(dict.fromkeys(job.arm for job in self.jobs))
            seeds = ", ".join(map(str, sorted({job.seed for job in self.jobs})))
            what, which = "A sweep of finished architecture searches", f"arms {arms}, seeds {seeds}"
        else:
            what = "A finished architecture search" if self.first.answered else "A run of given networks"
            which = f"seed {self.first.config.seed}"
        what += f" for tactile perception: task {self.first.record.task.name}, {which}, {sizes}."
        digest = f"The digest of {'the sweep' if self.jobs else 'its ledger'} is {self.digest}."
        note = (words if words[-1] in ".!?:" else f"{words}." for words in self.note)
        return " ".join([what, *answers, *data, *note, digest])


def origin_of_answers(run: RecordedRun) -> str:
    """Say what answered the requests, and plainly where that was not a language model."""
    config = run.config
    if not run.answered:
        return "No model was asked: the networks were given."
    if not config.llm.facts.is_model:
        return "Answers by the grammar provider: no LLM. Every network was drawn from a fixed grammar of architectures."
    kind = "" if run.record.elsewhere else "the language model "
    return f"Answers by {kind}{run.model} (llm={config.llm.provider})."


def origin_of_data(config: RunConfig) -> str:
    """Say where the images come from."""
    if config.data.facts.is_made:
        return "Images of a simulated sensor, not of a real one."
    if config.data.facts.is_looked_up:
        return "Evaluations were looked up in the table of a space (data=table), which is not part of this bundle."
    return f"Recorded images (data={config.data.source}), which are not part of this bundle."


def readme(subject: Subject, *, has_lock: bool) -> str:
    """Write the README from its template, `readme.template.md`."""
    run, is_sweep = subject.first, bool(subject.jobs)
    record, config = run.record, run.config
    train, validation, test = record.data.counts
    template = Template((Path(__file__).parent / "readme.template.md").read_text(encoding="utf-8"))
    versions, machine = (
        {name: in_markdown(str(value)) for name, value in of.items()} for of in (record.versions, record.machine)
    )
    values = {
        **versions,
        **machine,
        "title": in_markdown(subject.title),
        "description": in_markdown(replace(subject, note=()).description),
        "note": "\n\n".join(["", HEADING, *map(in_markdown, subject.note)]) if subject.note else "",
        "which": "every" if is_sweep else "the",
        "digests": "\n".join(_digests(subject)),
        "fingerprint": in_markdown(record.data.fingerprint),
        "train": train,
        "validation": validation,
        "test": test,
        "in_groups": in_groups(record.data),
        "image_size": record.data.image_size,
        "source": _origin(run, subject.folder),
        "of_which": " (the first run; the others say theirs)" if is_sweep else "",
        "numerics": config.numerics.kind,
        "device": config.training.device,
        "folder": subject.folder,
        "lock": "requirements.lock pins every package."
        if has_lock
        else "No lock file of these versions was at hand. requirements.lock pins what may change a result.",
        "contents": _OF_SWEEP if is_sweep else _OF_RUN,
    }
    return template.substitute(values)


_OF_RUN = """\
- `run/`: resolved configuration, ledger, archives, candidates' sources and rejected answers, summary, costs, studies\
"""

_OF_SWEEP = """\
- `sweep/sweep.json`: the jobs, and the settings that set them apart
- `sweep/JOB/`: of each job's run resolved configuration, ledger, archives, summary, costs, studies; its candidates'
  sources and rejected answers are in `store.jsonl.xz`, and test predictions of studies are left out\
"""


def _digests(subject: Subject) -> list[str]:
    """List the digests of ledgers and studies, and of a sweep as a whole."""
    names = [f"run of job {as_code(job.name)}" for job in subject.jobs] or ["ledger"]
    lines = [f"- sweep `{subject.digest}`"] if subject.jobs else []
    for name, run, studies in zip(names, subject.runs, subject.studies, strict=True):
        lines.append(f"- {name} `{run.ledger.digest}`")
        lines += [f"- study {as_code(study)}, digest {as_code(digest)}" for study, digest in sorted(studies.items())]
    return lines


def _origin(run: RecordedRun, folder: str) -> str:
    """Say how to make or obtain the data set of a run."""
    data = run.config.data
    if data.facts.is_made:
        given = [f"data.{key}={_plain(getattr(data, key))}" for key in _SIMULATED]
        given += [] if data.sensor == SimulatedSensor.ViTacTip else [f"data.sensor={data.sensor}"]
        given += [f"data.gel_mm={_plain(data.gel_mm)}"] if data.gel_mm else []
        settings = [f"task={run.record.task.name}", *given]
        return (
            "They are made, equal in every byte, when they are needed; as files by\n\n"
            f"    tacevo data simulate {on_a_line(shlex.join(settings))} out=DIR"
        )
    if data.facts.is_looked_up:
        return (
            f"None are needed: evaluations were looked up in a table, {as_code(str(data.root))}, whose digest this is. "
            "To look them up again, lay it beside this file or into cache/tables, under any name that ends in .zip, or "
            "name it by `tacevo replay FILE --retrain --table TABLE`."
        )
    return (
        "They are not part of this bundle: ask those who recorded them. To retrain, lay them as "
        f"{as_code(str(data.root))} "
        "(data.root) into the working directory; tacevo refuses any with another fingerprint. "
        f"{folder}/run.json says in `config.data` how they are read."
    )


def _plain(value: object) -> str:
    """Write a setting as on a command line."""
    return f"[{','.join(map(str, value))}]" if isinstance(value, tuple) else str(value)


def licence(terms: Terms) -> str:
    """Write the licence of a bundle."""
    holders = ", ".join(terms.authors) or "its authors"
    return (
        f"This published run is licensed by {holders} under {terms.licence}:\n{terms.licence_address}\n\n"
        "TacEvo, the software that made it, is licensed under Apache-2.0:\nhttps://spdx.org/licenses/Apache-2.0\n"
    )


def citation(subject: Subject, terms: Terms) -> str:
    """Write CITATION.cff (Citation File Format 1.2.0)."""
    return yaml_text(
        {
            "cff-version": "1.2.0",
            "message": f"If you use this {subject.what}, please cite it.",
            "type": "dataset",
            "title": subject.title,
            "abstract": subject.description,
            "authors": [{"name": author} for author in terms.authors or ("anonymous",)],
            "date-released": date.fromisoformat(terms.published),
            "license": terms.licence,
            "version": subject.digest,
        }
    )


def yaml_text(value: object) -> str:
    """Write YAML as a bundle has it."""
    return yaml.safe_dump(value, sort_keys=False, allow_unicode=True, width=110)
