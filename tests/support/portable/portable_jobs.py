"""What `test_portable.py` has computed in processes of their own, natively and under emulated CPUs.

Each job prints a JSON list a line: what was computed, and the digest of the bits it gave.
"""

import json
import math
from collections.abc import Iterator
from typing import Any

import fakes
import numpy as np
from hand_runs import of_lines
from kept import forces, gratings
from ledger_lines import header
from portable_printing import digest_of_json, show
from studies import FOUR, study_of
from threadpoolctl import threadpool_info

from analysis.studies.comparison import compare
from analysis.studies.image_findings import image_findings
from analysis.tables.comparison import study_tables
from analysis.tables.images import image_tables
from analysis.tables.published import published_tables
from analysis.tables.rendering import as_csv
from tacevo.choices import LightScene, SensorTask
from tacevo.config.compose import compose
from tacevo.data.simulator.tasks import Simulated, draw
from tacevo.errors import StoreError
from tacevo.evolution.algorithm import run_search
from tacevo.evolution.archive import find_centroids
from tacevo.evolution.descriptors import describe
from tacevo.gate import probe
from tacevo.profile import Profile
from tacevo.records import Contract, Rejection, to_json
from tacevo.reproduce.bits.networks import RECIPE, candidates, targets, trained
from tacevo.reproduce.bits.operations import digest
from tacevo.results.summary import summarise
from tacevo.runs.search_files import archive_files
from tacevo.sandbox.client import Finished, Frame
from tacevo.storage.ledger import Ledger
from tacevo.training.answers import judge
from tacevo.typed import convert


def probed(source: str, task: Contract) -> Profile:
    """Probe a network."""
    frames: list[Any] = []
    limits = {"parameters": 50_000_000, "flops": 10**10, "modules": 2_000}
    header = {"source": source, "contract": to_json(task), "limits": limits}
    probe.run(header, b"", {}, lambda frame, _: frames.append(frame))
    return convert(Profile, frames[0]["profile"], place="frame", error=StoreError)


def surroundings() -> None:
    """Show what a host offers: the bits of functions that choose their code by the CPU, and the CPU that BLAS sees."""
    many = np.linspace(-20, 20, 100_001)
    show("C library", digest_of_json([math.exp(value) for value in many.tolist()]))
    show("NumPy", digest([np.exp(many.astype(np.float32)).tobytes()]))
    show("BLAS", str(sorted({str(pool["architecture"]) for pool in threadpool_info() if "architecture" in pool})))


def networks() -> None:
    """Probe and train the three baselines and the networks of the package; then compute what else a run holds."""
    for name, source, task in candidates():
        profile = probed(source, task)
        frames = tuple(Frame(header, data) for header, data in trained(source, task))
        show(f"{name}: probe", digest_of_json(to_json(profile)))
        show(f"{name}: descriptors", digest_of_json(to_json(describe(profile))))
        show(f"{name}: training", digest([json.dumps(frame.header).encode() + frame.payload for frame in frames]))
        verdict = judge(Finished(frames), task, targets(task)[16:], epochs=RECIPE.epochs, steps=2, rows=8)
        if isinstance(verdict, Rejection):
            raise ValueError(f"{name} should train; got {verdict}")
        show(f"{name}: losses", digest_of_json(to_json(verdict[0])))
    for simulated in SensorTask:
        show(f"images and labels of {simulated}", digest(list(_simulated(simulated))))
    shape = {"niches": 25, "dimensions": 2, "samples": 2_000, "seed": 0}
    show("centroids", digest_of_json(find_centroids(**shape)))
    _search()
    _study()


def _simulated(task: SensorTask) -> Iterator[bytes]:
    """Return the labels of a simulated data set and two of its images."""
    source = Simulated(
        task=task,
        images=20,
        image_size=32,
        seed=0,
        sensor_seed=1,
        light=LightScene.side,
        spacings_mm=(0.5, 1.0, 2.0),
    )
    yield source.catalogue().labels.tobytes()
    yield from (draw(source, index).tobytes() for index in (0, 19))


def _search() -> None:
    """Search with fake effects: its ledger, its archives and the tables of its summary."""
    plan = fakes.plan(generations=2)
    recorder = fakes.Recorder()
    ledger = Ledger()
    state = run_search(plan, fakes.effects(), ledger, recorder)
    show("ledger", ledger.digest)
    elites = [elite.name for elite in state.networks.archive.elites.values()]
    show("archives", digest_of_json(to_json(archive_files(plan, state))))
    run = of_lines(header(), *recorder.lines, elites=dict.fromkeys(elites, 0), config=compose(["task=force"]))
    show("tables", digest([summarise(run).encode()]))


def _study() -> None:
    """Compare the networks of a study made by hand: its tables, and the paper's."""
    study = study_of(FOUR)
    tables = [*study_tables(study, compare(study)), *published_tables()]
    show("tables of a study", digest([as_csv(table).encode() for table in tables]))
    made = [forces(), gratings()]
    of_images = [table for one in made for table in image_tables(one[0], image_findings(*one))]
    show("tables of test images", digest([as_csv(table).encode() for table in of_images]))
