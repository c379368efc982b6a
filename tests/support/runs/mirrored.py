"""Runs that a mirror can show, without a search, and what MLflow then says of them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fakes import TASK
from ledger_lines import FACTS, ended, header, rejected, run_record, trained

from tacevo.environment import Code
from tacevo.evolution.archive import AddStatus
from tacevo.evolution.lines import CandidateLine
from tacevo.evolution.run_files import Line, line_kind
from tacevo.records import Instruction, Operator, to_json
from tacevo.storage.files import write_durably
from tacevo.storage.ledger import Ledger
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.sweep_directory import Job, SweepDirectory, SweepRecord

if TYPE_CHECKING:
    from mlflow import MlflowClient
    from mlflow.entities import Run

INSTRUCTIONS = (Instruction(id="widen", text="Widen every convolution."), Instruction(id="gelu", text="ReLU to GELU."))
#: A data set of the sensor's forces, and a commit, as run.json has them.
DATA = replace(FACTS, fingerprint="0123456789abcdef" * 4, counts=(60, 20, 20), image_size=64)
CODE: dict[str, Any] = {"commit": "fedcba98" * 5, "dirty": False}
HEADER = header(task="force", data=DATA)
FIGURES = {"train_losses": (0.75, 0.5), "parameters": 1200, "flops": 34000, "arch_div": 0.5, "eff_ratio": 1.5}
BASELINE = trained("g00s00", 0.25, **FIGURES)
MUTATION = trained("g00s01", 0.25, **FIGURES, temperature=0.625, status=AddStatus.rejected, curiosity=0.5)
REJECTED = rejected(
    "g00s02",
    "policy",
    "forbidden_import",
    operator=Operator.crossover,
    parents=("g00s00", "g00s01"),
    prompt=None,
)
GENERATION = ended(0, coverage=0.01, qd_score=0.8)
SECOND_GENERATION = replace(
    GENERATION,
    generation=1,
    candidates=0,
    trained=0,
    temperature=0.65,
    generation_best=None,
    generation_median=None,
)
LINES: list[Line] = [HEADER, BASELINE, MUTATION, REJECTED, GENERATION, SECOND_GENERATION]


def build_run(run_dir: Path, lines: Sequence[Line], *, whole: bool = True, uri: str = "") -> str:
    """Write a run directory, or continue one, as a search does; return the digest of its ledger."""
    for line in lines:
        if isinstance(line, CandidateLine) and line.fitness is not None:
            write_durably(run_dir / "candidates" / f"{line.id}.py", f"# {line.id}\n")
    run_dir.mkdir(parents=True, exist_ok=True)
    with Ledger.open(run_dir / "ledger.jsonl", line_kind) as ledger:
        for line in lines:
            ledger.commit(line)
        digest = ledger.digest
    RunDirectory(run_dir).write_json("run.json", facts(digest if whole else None, uri=uri))
    if whole:
        write_durably(run_dir / "summary.md", "found")
    return digest


def facts(digest: str | None = None, *, source: str = "simulated", root: str | None = None, uri: str = "") -> Any:
    """Return what run.json holds."""
    config = {
        "seed": 0,
        "llm": {"model": "m", "base_url": None},
        "data": {"source": source, "root": root},
        "tracking": {"kind": "none", "uri": uri, "experiment": "tacevo"},
    }
    task = replace(TASK, name="force", instructions=INSTRUCTIONS)
    described = {"config": config, "task": task, "data": DATA, "code": Code(**CODE)}
    return to_json(run_record(**described, digest=digest))


def mirror_once(run_dir: Path, uri: str) -> None:
    """Mirror what stands in a run directory, in this process."""
    from tacevo.tracking.mirror import mirror

    mirror(run_dir, uri=uri, experiment="tacevo", finished=None)


def open_store(uri: str) -> "tuple[MlflowClient, Run, dict[str, Run]]":
    """Read a store with one search back: the client, the parent run, the nested runs by candidate."""
    from mlflow import MlflowClient

    client = MlflowClient(uri)
    experiment = client.get_experiment_by_name("tacevo")
    assert experiment is not None
    runs = client.search_runs([experiment.experiment_id])
    parents = [run for run in runs if "tacevo.run" in run.data.tags]
    assert len(parents) == 1
    nested = [run for run in runs if run.data.tags.get("mlflow.parentRunId") == parents[0].info.run_id]
    assert len(nested) == len(runs) - 1
    by_candidate = {run.data.tags["tacevo.candidate"]: run for run in nested}
    assert len(by_candidate) == len(nested)
    return client, parents[0], by_candidate


def contents(uri: str) -> dict[str, Any]:
    """Return everything that a store says of a search, but for times and ids."""
    client, parent, nested = open_store(uri)
    return {"parent": said_by(client, parent), **{name: said_by(client, run) for name, run in nested.items()}}


def said_by(client: "MlflowClient", run: "Run") -> Any:
    """Return everything that a run says, but for times and ids."""
    histories = {
        key: [(point.step, point.value) for point in client.get_metric_history(run.info.run_id, key)]
        for key in run.data.metrics
    }
    shown = ("tacevo.", "mlflow.source.")
    tags = {key: value for key, value in run.data.tags.items() if key.startswith(shown)}
    data = [given.to_dictionary() for given in (run.inputs.dataset_inputs if run.inputs else ())]
    files = [file.path for file in client.list_artifacts(run.info.run_id)]
    return run.info.run_name, run.info.status, run.data.params, tags, histories, [*files, *data]


def everything(uri: str) -> dict[tuple[str, ...], Any]:
    """Return everything that a store says of any number of sweeps and searches, by the names of a run and those above.

    No two runs may have one name below one parent.
    """
    from mlflow import MlflowClient

    client = MlflowClient(uri)
    experiment = client.get_experiment_by_name("tacevo")
    assert experiment is not None
    runs = {run.info.run_id: run for run in client.search_runs([experiment.experiment_id], max_results=1000)}

    def path_of(run: "Run") -> tuple[str, ...]:
        above = run.data.tags.get("mlflow.parentRunId")
        return (*(() if above is None else path_of(runs[above])), str(run.info.run_name))

    said = {path_of(run): said_by(client, run) for run in runs.values()}
    assert len(said) == len(runs), "a run stands there twice"
    return said


def build_sweep(folder: Path, lines: Sequence[Line], *, arms: Sequence[str] = ("none", "greedy")) -> None:
    """Write the directory of a sweep, with a whole run for each arm, and one that is not begun for the next seed."""
    jobs = tuple(
        Job(name=f"{arm}-seed{seed}", arm=arm, seed=seed, overrides=(f"ablation={arm}",), config="0" * 64)
        for arm in arms
        for seed in (0, 1)
    )
    SweepDirectory(folder).write(SweepRecord(overrides=("experiment=demo",), jobs=jobs))
    for job in jobs:
        if job.seed == 0:
            build_run(folder / job.name, lines)
