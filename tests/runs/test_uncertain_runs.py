"""Promise: a run of several seeds is recorded, resumed and compared as any other."""

import json
from pathlib import Path

import pytest
from smallest import SMALLEST, UNTRACKED, Once

from analysis.report.collection import collect, tables_of
from analysis.report.page.of_run import RunMaterial, read_texts, run_contents
from analysis.runs.archive_history import archive_history
from tacevo.cli.app import main
from tacevo.storage.store import Store

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

SIZES = ["search.generations=2", "search.candidates=4", "search.initial=2", "training.seeds=3"]


@pytest.fixture(scope="session")
def uncertain(once: Once) -> Path:
    """Return a directory with a run of three seeds, and its noise run, to be left as it is."""

    def fill(folder: Path) -> None:
        where = [f"run.dir={folder / 'run'}", f"store.root={folder / 'cache'}", "executor.workers=2"]
        assert main(["search", *SMALLEST, UNTRACKED, *SIZES, *where]) == 0
        assert main(["noise", str(folder / "run"), "seeds=1"]) == 0

    return once("uncertain", fill)


def test_replay_and_retraining_compare_every_seed(uncertain: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As many evaluations as the store has of the search, bit for bit."""
    noise = len(json.loads(next(uncertain.glob("run/studies/*/study.json")).read_text())["networks"])
    count = len(list(Store(uncertain / "cache", "evaluations").entries())) - noise
    assert main(["replay", str(uncertain / "run"), "--retrain"]) == 0
    assert f"retrained: {count} of {count} evaluations" in capsys.readouterr().out


def test_one_worker_and_a_store_that_has_all_give_the_digest_of_two(uncertain: Path, tmp_path: Path) -> None:
    """Trainings are recalled one by one, and committed in the order of the slots."""
    where = [f"run.dir={tmp_path / 'run'}", f"store.root={uncertain / 'cache'}", "executor.workers=1"]
    assert main(["search", *SMALLEST, UNTRACKED, *SIZES, *where]) == 0
    digests = [json.loads((run / "run.json").read_text())["digest"] for run in (uncertain / "run", tmp_path / "run")]
    assert digests[0] == digests[1]


def test_tables_and_page_have_the_archive_as_the_search_left_it(uncertain: Path) -> None:
    """Rebuilt from the lines, with its corrected figures beside it; a candidate names the losses of all its seeds."""
    collection = collect(uncertain / "run", uncertain / "cache")
    last = archive_history(collection.run, collection.niches.networks)[-1]
    held = {niche: (elite.name, -elite.objective) for niche, elite in last.elites.items()}
    assert held == {elite.niche: (elite.id, elite.fitness) for elite in collection.run.elites}
    assert any(table.name.endswith("/corrected") for table in tables_of(collection, None))
    page = run_contents(RunMaterial(collection=collection, texts=read_texts(collection.run)[0]))
    losses = {one["id"]: len(one["losses"]) for one in page["candidates"]}
    assert losses == {line.id: 0 if line.fitness is None else 3 for line in collection.run.candidates}
