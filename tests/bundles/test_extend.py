"""Promise: a published run is continued by its own lines and under its own settings, and is itself left as it is."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from refusals import refused
from smallest import SMALLEST, UNTRACKED

import tacevo
from tacevo.bundles.extend import continued
from tacevo.cli.app import main
from tacevo.config.compose import compose
from tacevo.errors import ConfigError
from tacevo.storage.run_directory import RunDirectory

#: A real search of one generation, with stores of its own.
TINY = [*SMALLEST, UNTRACKED, "search.generations=1", "search.candidates=3", "search.initial=2"]
MORE = ["search.generations=2", UNTRACKED, "run.dir=mine"]


def content(folder: Path) -> dict[Path, bytes]:
    """Read every file of a directory."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_continued_run_equals_one_that_was_never_stopped(published: Path, place: Path) -> None:
    """The new ledger starts with the old one, where that was cut makes no difference, and nothing published changed."""
    before = content(published)
    command = ["extend", str(published / "run"), "--store", str(published / "cache"), *MORE]
    assert main(command) == 0
    assert content(published) == before
    old, new = ((path / "ledger.jsonl").read_bytes() for path in (published / "run", place / "mine"))
    assert new.startswith(old)
    assert len(new) > len(old)
    opened = tacevo.open(published / "run", store=published / "cache")
    assert isinstance(opened, tacevo.Run)
    again = tacevo.extend(opened, *MORE, quiet=True)
    assert again.digest == json.loads((place / "mine" / "run.json").read_text())["digest"]  # it was finished
    assert main(["search", *TINY, "search.generations=2", "run.dir=whole"]) == 0
    for run in ("mine", "whole"):
        assert (place / run / "ledger.jsonl").read_bytes() == new


def test_bundle_is_verified_and_continued_without_its_publishers_folders(published: Path, place: Path) -> None:
    """One file is enough, it stays as it is, and an entry that a bundle's replay needs reaches the stores here."""
    bundle = published / "run.zip"
    before = bundle.read_bytes()
    assert main(["extend", str(bundle), *MORE]) == 0
    assert bundle.read_bytes() == before
    old, new = (path / "ledger.jsonl" for path in (published / "run", place / "mine"))
    assert new.read_bytes().startswith(old.read_bytes())
    assert main(["replay", "mine"]) == 0
    theirs, ours = content(published / "cache"), content(place / "cache")
    (one, *_) = (path for path in theirs if path.parts[-3] == "completions")
    entry = ours[place / "cache" / one.relative_to(published / "cache")]
    assert json.loads(entry) == json.loads(theirs[one])
    assert entry.count(b"\n") == theirs[one].count(b"\n")


def test_what_cannot_be_continued_leaves_nothing(
    run: Path, published: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The published run is replayed before anything is asked, and stays as it is, however its directory is spelt."""
    command = ["extend", str(run), "--store", str(published / "cache"), *MORE]
    assert main([*command, f"run.dir={run}/../run"]) == 2
    assert "run.dir: expected another directory than that of the published run" in capsys.readouterr().err
    with refused(ConfigError, place="search.generations", expected="more than"):
        tacevo.extend("run", *MORE[1:], "search.generations=1", quiet=True)
    assert main([*command, "data.seed=5"]) == 2
    assert "the run's data set" in capsys.readouterr().err
    edited = run / "candidates" / "g00s00.py"
    edited.write_bytes(edited.read_bytes() + b"# edited\n")
    assert main(command) == 1
    assert "g00s00" in capsys.readouterr().err
    assert not Path("mine").exists()
    assert not Path("cache/completions").exists()


def test_folder_of_another_run_is_refused(
    published: Path, swept: Path, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run directory that holds another run is not written to."""
    shutil.copytree(swept / "sweep" / "none-seed1", place / "mine")
    before = content(place / "mine")
    assert main(["extend", str(published / "run"), "--store", str(published / "cache"), *MORE]) == 2
    assert "got a different or shorter ledger" in capsys.readouterr().err
    assert content(place / "mine") == before


SPENT = 1_200_000_000


@pytest.mark.few(4)
@pytest.mark.parametrize(
    ("override", "place"),
    [
        ("seed=1", "seed"),
        ("search.candidates=4", "search.candidates"),
        ("llm.slip_rate=0.5", "llm.slip_rate"),
        ("temperature=fixed", "temperature.rule"),
        ("training.epochs=9", "training.epochs"),
        ("numerics=fast", "numerics"),
        ("task=grating", "task"),
        ("task.loss=mse", "task.loss"),
        ("experiment=demo", "experiment"),
        ("search.generations=0", "search.generations"),
        ("search.generations=1", "search.generations"),
        ("search.training_flops=1e9", "search.training_flops"),  # more than a bound it may have had, less than it spent
        ("search.training_flops=1.2e9", "search.training_flops"),
    ],
)
def test_override_that_makes_another_run_or_none_that_is_longer_is_refused_by_name(override: str, place: str) -> None:
    """Whatever decides the results is the published run's; a run ends no sooner, by generations or by its budget."""
    with refused(ConfigError, place=place):
        continued(compose(TINY), ["search.generations=2", override], end=1, spent=SPENT)


@pytest.mark.few(1)
@pytest.mark.parametrize(("bound", "fits"), [("1.1e9", False), ("1.2e9", False), ("1.3e9", True), ("null", True)])
def test_run_that_its_budget_ended_needs_more_than_it_spent(bound: str, fits: bool) -> None:
    """More generations alone would end where it ended; with a larger budget it may have as many as were planned."""
    theirs = compose([*TINY, "search.generations=5", "search.training_flops=1e9"])
    for overrides in (["search.generations=9"], [f"search.training_flops={bound}"]):
        if fits and "flops" in overrides[0]:
            assert continued(theirs, overrides, end=1, spent=SPENT).search.generations == 5
        else:
            with refused(ConfigError, place="search.training_flops", expected=f"more than the {SPENT} that the run"):
                continued(theirs, overrides, end=1, spent=SPENT)


@pytest.mark.slow
def test_settings_of_the_machine_are_those_here_and_can_be_set() -> None:
    """Stores, place, tracker and workers of the publisher are not the reader's; budget and mode may be chosen."""
    theirs = compose([*TINY, "run.dir=theirs/run", "store.root=theirs/cache", "executor.workers=7"])
    here = continued(
        theirs, ["search.generations=3", "tracking=none", "llm.mode=replay", "llm.budget_usd=2"], end=1, spent=0
    )
    default = compose([])
    assert (here.store, here.run, here.executor) == (default.store, default.run, default.executor)
    assert (here.tracking.kind, here.llm.mode.value, here.llm.budget_usd) == ("none", "replay", 2)
    assert here.search.candidates == theirs.search.candidates
    assert continued(theirs, ["search.generations=3", "executor.workers=3"], end=1, spent=0).executor.workers == 3


def test_publisher_chooses_neither_the_server_nor_the_walls() -> None:
    """Whom the reader's key is sent to, what a token costs, and how candidates are held is settled here."""
    model = ["llm=openai", "llm.model=m", "llm.base_url=http://evil.example", "llm.prices=/dev/zero"]
    theirs = compose([*TINY, *model, "sandbox.require=none"])
    here = continued(theirs, ["search.generations=3"], end=1, spent=0)
    default = compose(["llm=openai", "llm.model=m"])
    assert (here.llm.provider, here.llm.model) == (theirs.llm.provider, theirs.llm.model)
    assert (here.llm.base_url, here.llm.prices) == (default.llm.base_url, default.llm.prices)
    assert here.sandbox == default.sandbox
    own = continued(theirs, ["search.generations=3", "llm.base_url=http://localhost:8000/v1"], end=1, spent=0)
    assert own.llm.base_url == "http://localhost:8000/v1"


def test_label_of_a_published_model_goes_on() -> None:
    """Whoever has the model under another path continues the run without naming the label again."""
    theirs = compose([*TINY, "llm=openai", "llm.model=llama-8b", "llm.label=llama-8b"])
    here = continued(theirs, ["search.generations=3", "llm.model=/mine/llama"], end=1, spent=0)
    assert (here.llm.model, here.llm.name) == ("/mine/llama", "llama-8b")


def test_other_versions_are_named_and_the_run_is_tried_all_the_same(
    run: Path, published: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run of another version replays where nothing that matters changed; a difference comes with the versions."""
    described = RunDirectory(run).read_run()
    RunDirectory(run).write_run(replace(described, versions={**described.versions, "tacevo": "0.0.1"}))
    command = ["replay", str(run), "--store", str(published / "cache")]
    assert main(command) == 0
    assert "another version: tacevo is" in capsys.readouterr().err
    (run / "archive.json").write_text("{}")
    assert main(command) == 2
    assert "another version may be the reason: tacevo is" in capsys.readouterr().err
