"""A published run as an RO-Crate 1.1 (https://w3id.org/ro/crate/1.1), the metadata that research archives read."""

import json
from collections.abc import Iterable

from rocrate.model.contextentity import ContextEntity
from rocrate.model.person import Person
from rocrate.model.softwareapplication import SoftwareApplication
from rocrate.rocrate import ROCrate

from tacevo.bundles.readme import Subject, Terms

#: Media types by the ending of a name; the longest that fits counts.
_TYPES = {
    ".cff": "application/yaml",
    ".csv": "text/csv",
    ".json": "application/json",
    ".jsonl": "application/jsonl",
    ".lock": "text/plain",
    ".md": "text/markdown",
    ".pdf": "application/pdf",
    ".py": "text/x-python",
    ".tex": "application/x-tex",
    ".txt": "text/plain",
    ".xz": "application/x-xz",
}

#: The descriptions of the members that a reader looks for first, by their names.
_DESCRIPTIONS = {
    "manifest-sha256.txt": "SHA-256 of every other file",
    "run/ledger.jsonl": "Every decision of the search, one line each, chained by hashes",
    "run/run.json": "Resolved configuration, task, data facts, versions, machine",
    "run/summary.md": "What the search found",
    "sweep/sweep.json": "The jobs of the sweep",
    "store.jsonl.xz": "Recorded answers, probes, evaluations, trainings and centroids",
}


def metadata(subject: Subject, terms: Terms, names: Iterable[str]) -> str:
    """Write `ro-crate-metadata.json`.

    Returns:
        JSON-LD in which nothing depends on when and where it is written.
    """
    crate = ROCrate(version="1.1")
    crate.name, crate.description = subject.title, subject.description
    crate.datePublished = terms.published
    address = terms.licence_address
    crate.license = crate.add(
        ContextEntity(crate, address, properties={"@type": "CreativeWork", "name": terms.licence, "url": address})
    )
    people = [
        crate.add(Person(crate, f"#author-{number}", properties={"name": name}))
        for number, name in enumerate(terms.authors, start=1)
    ]
    if people:
        crate.root_dataset["author"] = people
    crate.root_dataset["identifier"] = subject.digest
    for name in sorted(names):
        described = {"description": _DESCRIPTIONS[name]} if name in _DESCRIPTIONS else {}
        crate.add_file(
            dest_path=name,
            properties={"name": name, "encodingFormat": _TYPES[f".{name.rpartition('.')[2]}"], **described},
        )
    _add_action(crate, subject)
    return json.dumps(crate.metadata.generate(), indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def _add_action(crate: ROCrate, subject: Subject) -> None:
    """Name the software that made the run, as the Process Run Crate profile does."""
    version, jobs = subject.first.record.versions["tacevo"], subject.jobs
    named = "The searches of a sweep" if jobs else f"The search of {subject.first.record.name}"
    about = {"name": "TacEvo", "softwareVersion": version}
    software = crate.add(SoftwareApplication(crate, "#tacevo", properties=about))
    action = crate.add(ContextEntity(crate, "#search", properties={"@type": "CreateAction", "name": named}))
    action["instrument"] = software
    ledgers = [crate.get(f"{folder}/ledger.jsonl") for folder in [f"sweep/{job.name}" for job in jobs] or ["run"]]
    action["result"] = ledgers if jobs else ledgers[0]
    crate.root_dataset["mentions"] = action
