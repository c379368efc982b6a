"""What describes a published run or sweep to people: its README, licence and citation; pure."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from string import Template
from textwrap import fill

import yaml

from tacevo.errors import ConfigError
from tacevo.records import Json
from tacevo.storage.sweep_directory import Job, sweep_digest
from tacevo.text import counted

#: An identifier of a licence, as in https://spdx.org/licenses.
_SPDX = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]*")

#: The settings that a simulated data set follows from.
_SIMULATED = ("images", "image_size", "seed", "sensor_seed", "light", "spacings_mm")


@dataclass(frozen=True, slots=True, kw_only=True)
class Terms:
    """Under which terms a run is published, and by whom."""

    #: SPDX identifier of the bundle's own licence; the code's is Apache-2.0.
    licence: str
    authors: tuple[str, ...]
    #: As YYYY-MM-DD; empty for the day on which the run ended.
    published: str

    def __post_init__(self) -> None:
        """Check what the user wrote."""
        if _SPDX.fullmatch(self.licence) is None:
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
        """Where the licence stands."""
        return f"https://spdx.org/licenses/{self.licence}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """What is published."""

    #: What run.json holds, of one run or of a sweep's runs in the order of its jobs.
    runs: tuple[Mapping[str, Json], ...]
    #: Lines of their ledgers that are candidates.
    candidates: int
    #: Digest of each study, by name, for each run.
    studies: tuple[Mapping[str, str], ...]
    #: Of a sweep.
    jobs: tuple[Job, ...] = ()

    @property
    def first(self) -> Mapping[str, Json]:
        """Of the first run, which stands for all where a sweep's runs agree."""
        return self.runs[0]

    @property
    def what(self) -> str:
        """Call it what it is."""
        return "sweep" if self.jobs else "run"

    @property
    def digest(self) -> str:
        """The digest of the run's ledger, or of the sweep."""
        if not self.jobs:
            return str(self.first["digest"])
        return sweep_digest({job.name: run["digest"] for job, run in zip(self.jobs, self.runs, strict=True)})

    @property
    def folder(self) -> str:
        """Where a run of it lies in the bundle, for a person."""
        return "sweep/JOB" if self.jobs else "run"

    @property
    def title(self) -> str:
        """Give its title in a line."""
        task = self.first["task"]["name"]
        if self.jobs:
            return f"TacEvo sweep of {counted(len(self.jobs), 'run')}: architecture searches, task {task}"
        return f"TacEvo run {self.first['name']}: architecture search, task {task}"

    @property
    def description(self) -> str:
        """Say in a few sentences what it is, and what answered."""
        config = self.first["config"]
        count = sum(map(len, self.studies))
        studies = "1 study" if count == 1 else f"{count} studies"
        sizes = f"{counted(self.candidates, 'candidate')}, {studies}"
        answers = dict.fromkeys(origin_of_answers(run["config"]) for run in self.runs)
        data = dict.fromkeys(origin_of_data(run["config"]) for run in self.runs)
        if self.jobs:
            arms = ", ".join(dict.fromkeys(job.arm for job in self.jobs))
            seeds = ", ".join(map(str, sorted({job.seed for job in self.jobs})))
            what, which = "A sweep of finished architecture searches", f"arms {arms}, seeds {seeds}"
        else:
            what, which = "A finished architecture search", f"seed {config['seed']}"
        what += f" for tactile perception: task {self.first['task']['name']}, {which}, {sizes}."
        digest = f"The digest of {'the sweep' if self.jobs else 'its ledger'} is {self.digest}."
        return " ".join([what, *answers, *data, digest])


def origin_of_answers(config: Mapping[str, Json]) -> str:
    """Say what answered the requests, and plainly where that was no language model."""
    llm = config["llm"]
    if llm["provider"] == "grammar":
        return "Answers by the grammar provider: no LLM. Every network was drawn from a fixed grammar of architectures."
    return f"Answers by the language model {llm['model']} (llm={llm['provider']})."


def origin_of_data(config: Mapping[str, Json]) -> str:
    """Say where the images come from."""
    if config["data"]["source"] == "simulated":
        return "Images of a simulated sensor, not of a real one."
    return f"Recorded images (data={config['data']['source']}), which are not part of this bundle."


def readme(subject: Subject, *, has_lock: bool) -> str:
    """Write the README from its template, `readme.template.md`.

    Args:
        subject: what is published.
        has_lock: whether a lock file is in the bundle.
    """
    run, is_sweep = subject.first, bool(subject.jobs)
    data, config = run["data"], run["config"]
    train, validation, test = data["counts"]
    template = Template((Path(__file__).parent / "readme.template.md").read_text(encoding="utf-8"))
    values = {
        **run["versions"],
        **run["machine"],
        "title": subject.title,
        "description": subject.description,
        "which": "every" if is_sweep else "the",
        "digests": "\n".join(_digests(subject)),
        "fingerprint": data["fingerprint"],
        "train": train,
        "validation": validation,
        "test": test,
        "image_size": data["image_size"],
        "source": _origin(run, subject.folder),
        "of_which": " (the first run; the others say theirs)" if is_sweep else "",
        "numerics": config["numerics"]["kind"],
        "device": config["training"]["device"],
        "folder": subject.folder,
        "lock": "requirements.lock pins every package." if has_lock else "No lock file of these versions was at hand.",
        "contents": _OF_SWEEP if is_sweep else _OF_RUN,
    }
    text = template.substitute(values)
    return "\n\n".join(fill(part, 110) if part[0].isalnum() else part for part in text.split("\n\n"))


_OF_RUN = """\
- `run/`: resolved configuration, ledger, archives, candidates' sources and rejected answers, summary, costs, studies\
"""

_OF_SWEEP = """\
- `sweep/sweep.json`: the jobs, and the settings that set them apart
- `sweep/JOB/`: of each job's run resolved configuration, ledger, archives, candidates' sources and rejected answers,
  summary, costs, studies\
"""


def _digests(subject: Subject) -> list[str]:
    """List the digests of ledgers and studies, and of a sweep as a whole."""
    names = [f"run of job `{job.name}`" for job in subject.jobs] or ["ledger"]
    lines = [f"- sweep `{subject.digest}`"] if subject.jobs else []
    for name, run, studies in zip(names, subject.runs, subject.studies, strict=True):
        lines.append(f"- {name} `{run['digest']}`")
        lines += [f"- study `{study}`, digest `{digest}`" for study, digest in sorted(studies.items())]
    return lines


def _origin(run: Mapping[str, Json], folder: str) -> str:
    """Say how to make or obtain the data set of a run."""
    config = run["config"]["data"]
    if config["source"] == "simulated":
        settings = [f"task={run['task']['name']}", *(f"data.{key}={_plain(config[key])}" for key in _SIMULATED)]
        return (
            "They are made, equal in every byte, when they are needed; as files by\n\n"
            f"    tacevo data simulate {' '.join(settings)} out=FOLDER"
        )
    return (
        f"They are not part of this bundle: ask those who recorded them. To retrain, lay them as `{config['root']}` "
        "(data.root) into the working directory; tacevo refuses any with another fingerprint. "
        f"{folder}/run.json says in `config.data` how they are read."
    )


def _plain(value: Json) -> str:
    """Write a setting as on a command line."""
    return f"[{','.join(map(str, value))}]" if isinstance(value, list) else str(value)


def licence(terms: Terms) -> str:
    """Write the licence of a bundle."""
    holders = ", ".join(terms.authors) or "its authors"
    return (
        f"This published run is licensed by {holders} under {terms.licence}:\n{terms.licence_address}\n\n"
        "TacEvo, the software that made it, is licensed under Apache-2.0:\nhttps://spdx.org/licenses/Apache-2.0\n"
    )


def citation(subject: Subject, terms: Terms) -> str:
    """Write CITATION.cff (Citation File Format 1.2.0)."""
    authors: Sequence[dict[str, str]] = [{"name": author} for author in terms.authors]
    return yaml.safe_dump(
        {
            "cff-version": "1.2.0",
            "message": f"If you use this {subject.what}, please cite it.",
            "type": "dataset",
            "title": subject.title,
            "abstract": subject.description,
            "authors": authors or [{"name": "anonymous"}],
            "date-released": date.fromisoformat(terms.published),
            "license": terms.licence,
            "version": subject.digest,
        },
        sort_keys=False,
        allow_unicode=True,
        width=110,
    )
