"""`tacevo ablations` as a user gives it, over real runs: what it writes and says, and every mistake in one line."""

import csv
import json
import shlex
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from run_files import contents
from smallest import SMALLEST, UNTRACKED, Once
from tiny_sweep import SIZES

import tacevo
from tacevo.cli.app import main
from tacevo.cli.common import FORMATS
from tacevo.config.identity import config_hash
from tacevo.records import Json
from tacevo.results.run import read_run
from tacevo.storage.sweep_directory import Job, SweepDirectory, SweepRecord

ARMS = ("none", "no_prompt_archive")
JOBS = tuple(
    Job(name=f"{arm}-seed{seed}", arm=arm, seed=seed, overrides=(f"ablation={arm}",), config="")
    for arm in ARMS
    for seed in range(2)
)


@pytest.fixture(scope="session")
def compared(swept: Path, once: Once) -> Path:
    """Return the directory of a sweep of two arms and two seeds, whose answers are those of `swept`."""

    def search(folder: Path) -> None:
        shutil.copytree(swept / "cache", folder / "store")
        directory = SweepDirectory(folder / "sweep")
        for job in JOBS:
            where = [f"run.dir={folder / 'sweep' / job.name}", f"store.root={folder / 'store'}"]
            assert main(["search", *SMALLEST, UNTRACKED, *SIZES, *where, *job.overrides, f"seed={job.seed}"]) == 0
        jobs = tuple(with_hash(directory, job) for job in JOBS)
        directory.write(SweepRecord(overrides=tuple(SMALLEST), jobs=jobs))

    return once("compared", search)


def with_hash(directory: SweepDirectory, job: Job) -> Job:
    """Return a job the hash of its run's configuration, as launching does."""
    return replace(job, config=config_hash(read_run(directory.run(job).path).config))


@pytest.fixture
def sweep(compared: Path, place: Path) -> Path:
    """Return a copy of the sweep, to be spoilt, and work beside it."""
    shutil.copytree(compared / "sweep", place / "sweep")
    return Path("sweep")


def edit_run(sweep: Path, name: str, **fields: Json) -> None:
    """Change fields of a job's run.json."""
    path = sweep / name / "run.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **fields}))


def edit_sweep(sweep: Path, **fields: Json) -> None:
    """Change fields of sweep.json."""
    path = sweep / "sweep.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **fields}))


def rows(sweep: Path, table: str) -> list[dict[str, str]]:
    """Read a table as its CSV has it."""
    (path,) = (sweep / "ablations").rglob(f"{table}.csv")
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.room("figures")
def test_tables_and_figures_are_written(sweep: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each table and figure in three formats; on one screen the primary metric, and where the others are."""
    assert main(["ablations", "sweep"]) == 0
    told = capsys.readouterr()
    folder = sweep / "ablations"
    written = contents(folder)
    tables = {name.removesuffix(".md") for name in written if name.endswith(".md")} - {"index"}
    assert {name for name in tables if "/" not in name} == {"ablation"}  # it states no primary metric
    assert {"more/ablation_best_fitness", "more/ablation_runs"} <= tables
    assert "more/ablation_cost" in tables  # what answers of the tests' own provider cost is not known
    drawn = {f"ablation_{name}.{kind}" for name in ("curves", "finals", "forest") for kind in FORMATS}
    others = {*drawn, "index.md"}
    assert set(written) == {f"{name}{ending}" for name in tables for ending in (".md", ".tex", ".csv")} | others
    lines = told.out.splitlines()
    assert len(lines) <= 25
    assert {line.split()[1] for line in lines if line.startswith("| n")} == set(ARMS)
    assert lines[-1].startswith("tables and figures: sweep/ablations ")
    assert "left out" not in told.err
    assert main(["ablations", "sweep"]) == 0
    assert contents(folder) == written


@pytest.mark.slow
def test_sweep_without_test_scores_says_what_to_type(sweep: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With the path as it was given, which no table can have: a published one is compared wherever it lies."""
    edit_sweep(sweep, terms={"primary": "test_score"})
    assert main(["ablations", "sweep"]) == 0
    (line,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("next:"))
    assert shlex.split(line)[-3:] == ["study", "sweep=sweep", "seeds=5"]


@pytest.mark.slow
def test_best_fitness_is_that_of_the_ledgers(sweep: Path) -> None:
    """Run by run, as the last line of each ledger has it."""
    assert main(["ablations", "sweep", "-o", str(sweep / "ablations")]) == 0
    for row in rows(sweep, "ablation_runs"):
        last = json.loads((sweep / row["run"] / "ledger.jsonl").read_text().splitlines()[-1])
        assert float(row["best fitness"]) == last["best"]


@pytest.mark.slow
def test_missing_jobs_are_named(sweep: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Not begun, stopped and failed ones, with the reason, on the error output and below every table."""
    directory = SweepDirectory(sweep)
    shutil.rmtree(sweep / "none-seed1")
    edit_run(sweep, "no_prompt_archive-seed0", digest=None)
    shutil.rmtree(sweep / "no_prompt_archive-seed1")
    directory.fail(JOBS[3], "no answer came")
    assert main(["ablations", "sweep", "-o", "out"]) == 0
    told = capsys.readouterr()
    assert [line for line in told.err.splitlines() if line.startswith("left out")] == [
        "left out: none-seed1: not begun",
        "left out: no_prompt_archive-seed0: stopped",
        "left out: no_prompt_archive-seed1: failed: no answer came",
    ]
    names = "none-seed1, no_prompt_archive-seed0, no_prompt_archive-seed1"
    notes = Path("out/more/ablation_best_fitness.md").read_text()
    assert f"Missing, 3 jobs: {names}." in notes
    assert "Failed, 1 job: no_prompt_archive-seed1 (arm no_prompt_archive, its search)." in notes
    assert "Failed" not in Path("out/more/ablation_tokens.md").read_text()
    assert not (sweep / "ablations").exists()


@pytest.mark.slow
def test_job_that_the_scheduler_ended_is_no_result_of_its_arm(sweep: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nor is one that failed and runs again: the arm with the slower networks would lose by the partition's limit."""
    directory = SweepDirectory(sweep)
    edit_run(sweep, "no_prompt_archive-seed0", digest=None)
    shutil.rmtree(sweep / "no_prompt_archive-seed1")
    directory.fail(JOBS[2], "no answer came")
    directory.fail(JOBS[3], "Slurm: NODE_FAIL", by_scheduler=True)
    with directory.run(JOBS[2]).locked():
        assert main(["ablations", "sweep", "-o", "out"]) == 0
        opened = tacevo.open("sweep")
        assert isinstance(opened, tacevo.Sweep)
        assert list(opened.jobs.state) == ["finished", "finished", "running", "stopped"]
        compared = opened.contrasts("best fitness")
        assert list(compared.index) == ["none"]
        (said,) = compared.attrs["left_out"]
        assert "arm no_prompt_archive" in said
    assert [line for line in capsys.readouterr().err.splitlines() if line.startswith("left out")] == [
        "left out: arm no_prompt_archive: no seed of it is finished yet",
        "left out: no_prompt_archive-seed0: running",
        "left out: no_prompt_archive-seed1: stopped: Slurm: NODE_FAIL",
    ]
    assert "Failed" not in Path("out/more/ablation_best_fitness.md").read_text()


@pytest.mark.room("figures")
def test_reference_that_is_not_an_arm_is_refused(sweep: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The arms that there are stand in the message."""
    assert main(["ablations", "sweep", "--reference", "nobody"]) == 2
    assert "--reference: expected one of the arms: 'no_prompt_archive', 'none'; got 'nobody'" in capsys.readouterr().err


def _edit(sweep: Path) -> None:
    ledger = sweep / "none-seed1" / "ledger.jsonl"
    ledger.write_text(ledger.read_text().replace('"status":"new"', '"status":"improved"', 1))


def _repeat(sweep: Path) -> None:
    shutil.rmtree(sweep / "none-seed1")
    shutil.copytree(sweep / "none-seed0", sweep / "none-seed1")


def _exchange(sweep: Path) -> None:
    """Let runs of one seed change places: each is sound in itself, and every contrast is the other way round."""
    for seed in range(2):
        one, other = sweep / f"none-seed{seed}", sweep / f"no_prompt_archive-seed{seed}"
        one.rename(sweep / "moved")
        other.rename(one)
        (sweep / "moved").rename(other)


@pytest.mark.room("figures")
@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (_edit, "sweep/none-seed1/ledger.jsonl"),
        (_repeat, "sweep/none-seed1: expected seed 1, as sweep.json states of job none-seed1; got a run of seed 0"),
        (_exchange, "as sweep.json states of job none-seed0; got a run of config "),
    ],
)
def test_run_that_is_not_its_jobs_is_refused(
    spoil: Callable[[Path], None], said: str, sweep: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is not passed over as if it were missing, and nothing is written."""
    spoil(sweep)
    assert main(["ablations", "sweep"]) == 2
    assert said in capsys.readouterr().err
    assert not (sweep / "ablations").exists()
