"""A tiny sweep for tests: two arms and two seeds, one pair of which is left out."""

import json
from pathlib import Path

from smallest import SMALLEST, UNTRACKED

from tacevo.config.identity import config_hash
from tacevo.records import Json
from tacevo.storage.sweep_directory import Job, SweepDirectory, SweepRecord, name_arm

#: What all jobs share.
SIZES = ["search.generations=1", "search.candidates=2", "search.initial=1"]

#: What sets them apart, by name.
OWN = {
    "none-seed0": ("ablation=none", "seed=0"),
    "none-seed1": ("ablation=none", "seed=1"),
    "fixed_temperature-seed0": ("ablation=fixed_temperature", "seed=0"),
}


def run_sweep(folder: Path, store: Path) -> None:
    """Run the jobs, and write sweep.json."""
    from tacevo.cli.app import main

    shared = [*SMALLEST, UNTRACKED, *SIZES, f"store.root={store}"]
    directory = SweepDirectory(folder)
    for name, own in OWN.items():
        assert main(["search", *shared, *own, f"run.dir={folder / name}"]) == 0
    directory.write(SweepRecord(overrides=tuple(shared), jobs=tuple(_job(directory, name) for name in OWN)))


def _job(directory: SweepDirectory, name: str) -> Job:
    job = Job(name=name, arm=name_arm(OWN[name]), seed=int(name[-1]), overrides=OWN[name], config="")
    config = OLD_SETTINGS(directory.run(job))  # _
    return Job(name=name, arm=job.arm, seed=job.seed, overrides=job.overrides, config=config_hash(config))


def edited(text: bytes, place: int, **changes: Json) -> bytes:
    """Change fields of one job in the text of a sweep.json."""
    value = json.loads(text)
    value["jobs"][place] |= changes
    return jobs_text(value)


def jobs_text(value: Json) -> bytes:
    """Write a sweep.json in the form that it has in a bundle."""
    return (json.dumps(value, indent=1, ensure_ascii=False) + "\n").encode()
