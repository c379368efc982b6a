"""The table of a space is whole or refused, searches look it up as if they trained, and its rows train again alike."""

import hashlib
import re
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
from made_up import TINY, made_up_table
from refusals import refused

import tacevo
from tacevo.choices import Primary
from tacevo.cli.app import main
from tacevo.config.compose import compose, compose_study
from tacevo.errors import BundleError, CacheMissError, ConfigError, DivergenceError, RunError
from tacevo.evolution.fitness import Lowest
from tacevo.evolution.lines import CandidateLine
from tacevo.parts.kinds import FITNESS
from tacevo.records import Json, Reason, Rejection, Stage, to_json
from tacevo.reproduce.replay import replay
from tacevo.reproduce.retrain import retrain
from tacevo.reproduce.space_table import measure_table, retrain_table, verify_table
from tacevo.results.run import RecordedRun, read_run
from tacevo.results.space_table import card, check_networks, check_size, read_table, write_table
from tacevo.results.table_header import is_table
from tacevo.results.table_records import CARD, MANIFEST, SpaceTable, TableTraining
from tacevo.rules import CURRENT, LIKE_TODAY, STUDY
from tacevo.runs.progress import Progress
from tacevo.runs.session import search
from tacevo.storage.canonical import canonical
from tacevo.storage.entries import ReadBudget
from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.storage.zipfiles import MOST_OF_A_MEMBER, packed, read_members
from tacevo.studies.of_sweep import study_sweep
from tacevo.studies.tabulate import members as members_of
from tacevo.studies.tabulate import tabulate
from tacevo.sweeps.sweeping import sweep
from tacevo.sweeps.terms import Asked
from tacevo.training.full import FullTraining

#: Of the tests' tables that nothing was trained for.
SIZES = ("training.epochs=4",)


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> SpaceTable:
    """Make up the table of a tiny space."""
    return made_up_table(tmp_path_factory.mktemp("table") / "made up.zip", *TINY, *SIZES)


def _looked_up(table: SpaceTable, folder: Path, *overrides: str) -> RecordedRun:
    """Search a table."""
    place = [f"data.root={table.path}", f"run.dir={folder / 'run'}", f"store.root={folder / 'cache'}"]
    settings = ["experiment=space", *TINY, "data=table", "training.epochs=3", *place, *overrides]
    search(compose(settings), Progress())
    return read_run(folder / "run")


def _trained(run: RecordedRun) -> list[CandidateLine]:
    return [line for line in run.candidates if line.stage is None]


def test_fitness_is_the_beginning_of_a_recorded_training(table: SpaceTable, tmp_path: Path) -> None:
    """Every candidate is a network of the table, and its losses are the first of one of its recorded seeds."""
    run = _looked_up(table, tmp_path)
    rows = {network.sha256: row for row, network in enumerate(table.networks)}
    for line in run.candidates:
        row = rows[str(line.source)]
        full = [table.verdicts[row, seed] for seed in range(3)]
        curves = [one.training.validation_losses[:3] for one in full if isinstance(one, FullTraining)]
        assert line.validation_losses in curves
        assert line.fitness == Lowest().of(line.validation_losses)
        profile = table.networks[row].profile
        assert profile is not None
        assert (line.parameters, line.flops) == (profile.parameters, profile.flops)
    assert run.record.data.fingerprint == table.digest
    assert not list((tmp_path / "cache" / "data").glob("*"))  # no image was made


def test_equal_sources_share_a_recorded_seed_and_networks_draw_their_own(table: SpaceTable, tmp_path: Path) -> None:
    """Noise is that of a draw a network: independent between networks and between searches."""
    drawn = []
    for seed in range(2):
        run = _looked_up(table, tmp_path / str(seed), f"seed={seed}")
        by_source: dict[str, set[tuple[float, ...]]] = {}
        for line in run.candidates:
            by_source.setdefault(str(line.source), set()).add(line.validation_losses or ())
        assert all(len(losses) == 1 for losses in by_source.values())
        curves = {network.sha256: row for row, network in enumerate(table.networks)}
        for source, losses in by_source.items():
            full = [table.verdicts[curves[source], index] for index in range(3)]
            starts = [one.training.validation_losses[:3] for one in full if isinstance(one, FullTraining)]
            drawn.append(starts.index(next(iter(losses))))
    assert len(set(drawn)) > 1


def test_looked_up_run_replays_and_its_rows_are_looked_up_again(table: SpaceTable, tmp_path: Path) -> None:
    """It is a run as any other; a retraining compares it with the table."""
    run = _looked_up(table, tmp_path)
    assert replay(run, Progress()).digest == run.digest
    told = retrain([run], 2, 1, Progress())
    assert "bit for bit as recorded" in told
    assert f"nothing was trained: these were looked up in {table.path}" in told


#: Opens the tiny space to more networks than a surrogate needs.
WIDER = ("llm.space.width=[16,32]", "llm.space.activation=[relu,gelu]", "llm.space.norm=[none,batch]")


def _skipping(folder: Path, generations: int) -> RecordedRun:
    """Search a made-up table of 65 networks, and skip half."""
    table = made_up_table(folder / "made up.zip", *TINY, *WIDER, *SIZES)
    return _looked_up(table, folder, *WIDER, "proposals.skipped=0.5", f"search.generations={generations}")


@pytest.mark.slow
def test_search_that_skips_is_a_run_as_any_other(tmp_path: Path) -> None:
    """It replays without a model, its trainings come again, and its noise is of what it trained."""
    run = _skipping(tmp_path, 5)
    skipped = {line.id for line in run.candidates if line.skipped}
    assert skipped
    assert replay(run, Progress()).digest == run.digest
    assert "bit for bit as recorded" in retrain([run], 2, 1, Progress())
    opened = tacevo.open(run.path)
    assert isinstance(opened, tacevo.Run)
    assert {*opened.candidates.index[opened.candidates.outcome == "skipped"]} == skipped
    assert not skipped & {*tacevo.noise(run.path, quiet=True, elites=2, seeds=2).reestimates.network}


@pytest.mark.slow
def test_search_that_skips_is_extended(tmp_path: Path) -> None:
    """To the digest of a search that was as long at once."""
    run, longer = _skipping(tmp_path / "one", 5), _skipping(tmp_path / "two", 7)
    place = ["tracking=none", f"run.dir={tmp_path / 'longer'}", f"store.root={tmp_path / 'one' / 'cache'}"]
    extended = tacevo.extend(run.path, "search.generations=7", *place, quiet=True)
    assert extended.recorded.digest == longer.digest != run.digest


def test_noise_run_is_of_trainings_that_the_search_has_not_seen(table: SpaceTable, tmp_path: Path) -> None:
    """Each re-estimate is another recorded training; a study is refused, whose test predictions are in no table."""
    run = _looked_up(table, tmp_path)
    done = tacevo.noise(run.path, quiet=True, elites=2, seeds=2)
    for network, rows in done.reestimates.groupby("network"):
        assert len({*rows["recorded"], *rows["fitness"]}) == 3, network
    with refused(ConfigError, place="data=table", expected="images"):
        tacevo.study(run.path, quiet=True, elites=1, seeds=2, epochs=2)


@pytest.mark.few(4)
@pytest.mark.parametrize(
    ("override", "place"),
    [
        ("training.learning_rate=0.1", "training.learning_rate"),
        ("training.batch_size=8", "training.batch_size"),
        ("training.epochs=5", "training.epochs"),
        ("llm.space.width=[32]", "llm.space"),
        ("data.image_size=64", "data.image_size"),
        ("gate.max_parameters=1000", "gate.max_parameters"),
        ("task.target_scaling=none", "task.target_scaling"),
        ("task.output_argument=classes", "task.output_argument"),
        ("task.outputs=6", "task.outputs"),
        ("llm.slip_rate=0.01", "llm.slip_rate"),
    ],
)
def test_search_of_other_settings_is_refused(table: SpaceTable, tmp_path: Path, override: str, place: str) -> None:
    """A recorded training under another recipe would be another training, and one training counts once."""
    with refused(ConfigError, place=place):
        _looked_up(table, tmp_path, override)
    assert not (tmp_path / "run").exists()


def test_sweep_with_a_job_that_the_table_does_not_suit_is_refused_before_one_runs(
    table: SpaceTable, tmp_path: Path
) -> None:
    """As any mistake in a job."""
    settings = ["experiment=space", *TINY, "data=table", f"data.root={table.path}", "training.epochs=3", "seed=0"]
    with refused(ConfigError, place="llm.slip_rate"):
        sweep([*settings, "llm.slip_rate=0,0.01", f"store.root={tmp_path}"], str(tmp_path / "sweep"), Progress())
    assert not (tmp_path / "sweep").exists()


@pytest.mark.slow
def test_no_study_is_the_next_step_of_what_was_looked_up(
    table: SpaceTable, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A sweep states a metric that needs none, its noise runs name none, and test scores as its metric are refused."""
    settings = ["experiment=space", *TINY, "data=table", f"data.root={table.path}", "training.epochs=2", "seed=0,1"]
    settings += ["search.generations=1", "search.candidates=2", "tracking=none"]
    with refused(ConfigError, place="--primary", expected="no test images"):
        sweep(settings, "tested", Progress(), asked=Asked(primary=Primary.test_loss))
    assert not Path("tested").exists()
    for command in (["search", "-m", *settings, "--into", "all"], ["ablations", "all"], ["tables", "all/none-seed0"]):
        assert main(command) == 0
    assert main(["noise", "all/none-seed0", "elites=1", "seeds=2"]) == 0
    said = capsys.readouterr()
    assert re.search("next: .*tacevo ablations all$", said.out, re.MULTILINE)
    assert "tacevo study" not in said.out + said.err
    with refused(ConfigError, place="job none-seed0, data=table", expected="images"):
        study_sweep(Path("all"), compose_study(["sweep=all"]), Progress())
    assert SweepDirectory(Path("all")).read().terms.retraining is None


@pytest.mark.few(1)
@pytest.mark.parametrize("part", ["static", "probe", "training"])
def test_table_of_other_rules_is_refused(table: SpaceTable, tmp_path: Path, part: str) -> None:
    """What other rules measured is not what a search of today would measure."""
    rules = replace(CURRENT, **{part: min(LIKE_TODAY[part]) - 1})
    older = write_table(tmp_path / "old.zip", replace(table.header, rules=rules), table.networks, table.trainings)
    assert older.digest != table.digest
    with refused(ConfigError, place=f"rules.{part}"):
        _looked_up(older, tmp_path)


def test_noise_run_of_more_seeds_than_are_left_is_refused(table: SpaceTable, tmp_path: Path) -> None:
    """One training would count twice; nothing is begun."""
    run = _looked_up(table, tmp_path)
    with refused(ConfigError, place="seeds", expected="at most 2", got="3"):
        tacevo.noise(run.path, quiet=True, elites=1, seeds=3)
    assert not list(run.path.glob("studies/*"))


def test_digest_is_of_what_decides_the_rows(table: SpaceTable, tmp_path: Path) -> None:
    """Settings of searches, machines and prompts do not enter; the recipe and each row do."""

    def digest(settings: Mapping[str, Json] | None = None, **header: Any) -> str:
        config: dict[str, Any] = {**table.header.config}
        for key, value in (settings or {}).items():
            group, _, name = key.partition(".")
            config[group] = {**config[group], name: value} if name else value
        changed = replace(table.header, **{"config": config, **header})
        return write_table(tmp_path / "other.zip", changed, table.networks, table.trainings).digest

    others: dict[str, Json] = {
        "search.generations": 9,
        "seed": 7,
        "gate.seconds": 1,
        "training.seconds": 9,
        "training.fitness": "last",
    }
    others |= {"data.seed": 9, "archive.niches": 9, "executor.workers": 9, "tracking.uri": "x", "task.images": 99}
    task, rules = replace(table.header.task, system="another prompt"), replace(table.header.rules, core=1)
    assert digest(others, versions={}, machine={}, task=task, rules=rules) == table.digest
    changed = [
        digest({"training.learning_rate": 0.1}),
        digest({"gate.max_flops": 9}),
        digest(study=STUDY - 1),
        digest(trivial=1.0),
    ]
    assert len({*changed, table.digest}) == 5


@pytest.mark.slow
def test_table_that_no_reader_takes_is_refused_before_the_first_training(tmp_path: Path) -> None:
    """It could not be read again after hours."""
    store = f"store.root={tmp_path}"
    config = compose(["experiment=space", *TINY, "data.images=100", store, "training.epochs=50"])
    with refused(ConfigError, place="--seeds"):
        tabulate(config, tmp_path / "t.zip", Progress(), seeds=9999)
    assert not list(tmp_path.glob("probes/*"))


def test_place_that_cannot_be_written_to_is_refused_before_anything_is_made(place: Path) -> None:
    """A directory, or a place below a file, takes no table."""
    (place / "file").touch()
    (place / "made").mkdir()
    for target in ("made", "file/t.zip"):
        assert main(["tabulate", "experiment=space", *TINY, "store.root=cache", "-o", target]) == 2
    assert not (place / "cache").exists()


def test_largest_table_that_is_begun_can_be_written(table: SpaceTable) -> None:
    """The bound holds for the longest numbers, and is not far above the usual ones."""
    lines = [len(canonical(to_json(row))) for row in table.trainings]
    most = MOST_OF_A_MEMBER // max(lines) // len(table.header.seeds)
    with refused(ConfigError, place="--seeds"):
        check_size(table.header, most + 1)
    check_size(table.header, most // 2)


@pytest.mark.slow
def test_networks_that_no_table_holds_are_refused_once_they_are_measured(table: SpaceTable, tmp_path: Path) -> None:
    """Nothing is trained for a file that cannot be written."""
    networks = table.networks * (2 * MOST_OF_A_MEMBER // sum(len(canonical(to_json(row))) for row in table.networks))
    with refused(BundleError, place="t.zip", expected="networks.jsonl"):
        check_networks(tmp_path / "t.zip", networks)
    check_networks(tmp_path / "t.zip", table.networks)


def test_a_directory_is_no_table(tmp_path: Path) -> None:
    """Other data have a directory there."""
    with refused(BundleError, place=str(tmp_path), expected="table"):
        read_table(tmp_path)


def test_size_of_a_member_is_checked_before_the_file_is_replaced(table: SpaceTable, tmp_path: Path) -> None:
    """What stands at the path stays."""
    path = tmp_path / "standing.zip"
    path.write_bytes(b"standing")
    long = replace(table.networks[0], source="x" * MOST_OF_A_MEMBER)
    with refused(BundleError, expected="networks.jsonl"):
        write_table(path, table.header, [long], [])
    assert path.read_bytes() == b"standing"


def test_network_that_is_not_in_the_table_is_an_error(table: SpaceTable, tmp_path: Path) -> None:
    """It is named, and nothing is guessed."""
    fewer = tmp_path / "fewer.zip"
    write_table(fewer, table.header, table.networks[:1], [row for row in table.trainings if row.network == 0])
    with refused(CacheMissError, place=str(fewer), got="class SingleLabelClassCNN"):
        _looked_up(read_table(fewer), tmp_path)


def test_network_that_failed_is_a_rejected_candidate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its row says why, a replay counts it, and a search goes on without it."""
    failing = made_up_table(tmp_path / "made up.zip", *TINY, *SIZES, failing=3)
    assert failing.failures == [f"network 3, seed {seed}: not_finite" for seed in range(3)]
    assert main(["replay", str(failing.path)]) == 0
    assert re.search(r"\b0 networks\b.*\b3 trainings\b", capsys.readouterr().out)
    run = _looked_up(failing, tmp_path)
    rejected = {line.source for line in run.candidates if line.reason == "not_finite"}
    assert rejected == {failing.networks[3].sha256}
    assert _trained(run)


def test_equal_rows_give_equal_bytes(table: SpaceTable, tmp_path: Path) -> None:
    """Nothing of the time or place of making is in the file."""
    again = write_table(tmp_path / "again.zip", table.header, table.networks, table.trainings)
    assert again.path.read_bytes() == table.path.read_bytes()
    assert again.digest == table.digest


def test_made_up_table_says_so_and_is_never_retrained(
    table: SpaceTable, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its name, its card, its API and each search of it do; its networks verify."""
    _looked_up(table, tmp_path, "search.generations=0")
    assert "made up" in capsys.readouterr().err.replace(str(table.path), "")
    assert "MADE UP" in table.name
    assert b"MADE UP" in _members(table.path)[CARD]
    assert tacevo.open_table(table.path).is_made_up
    verify_table(table)
    with refused(BundleError, got="made-up"):
        retrain_table(table, 1, 1, None, Progress())


def _members(path: Path) -> dict[str, bytes]:
    return read_members(path, re.compile(".*"), ReadBudget(path, path.stat().st_size))


@pytest.mark.parametrize("name", ["table.json", "networks.jsonl", "trainings.jsonl", CARD, MANIFEST])
def test_damaged_table_is_refused(table: SpaceTable, tmp_path: Path, name: str) -> None:
    """An edited or a missing member is seen, whatever it is."""
    members = _members(table.path)
    edited, lacking = tmp_path / "edited.zip", tmp_path / "lacking.zip"
    edited.write_bytes(packed({**members, name: members[name].replace(b"e", b"f", 1)}))
    lacking.write_bytes(packed({key: data for key, data in members.items() if key != name}))
    for path in (edited, lacking):
        with pytest.raises(BundleError) as caught:
            read_table(path)
        assert "publish" not in str(caught.value)
    assert is_table(edited)
    cut = tmp_path / "cut.zip"
    cut.write_bytes(table.path.read_bytes()[:-9])
    with pytest.raises(BundleError) as caught:
        read_table(cut)
    assert "publish" not in str(caught.value)


def test_table_of_a_later_version_is_refused_as_one(table: SpaceTable, tmp_path: Path) -> None:
    """Readers raise their own kind of error for a setting that they do not know."""
    members = _members(table.path)
    members["table.json"] = members["table.json"].replace(b'"config": {', b'"config": {"later": {},')
    members[MANIFEST] = "".join(
        f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in sorted(members.items()) if name != MANIFEST
    ).encode()
    (tmp_path / "later.zip").write_bytes(packed(members))
    with refused(BundleError, place="table.json, config.later", remedy="another version"):
        read_table(tmp_path / "later.zip")


@pytest.mark.few(2)
@pytest.mark.parametrize("number", [0, 99])
@pytest.mark.parametrize("part", ["static", "probe", "training", "core", "study"])
def test_table_of_unknown_rules_is_refused(table: SpaceTable, tmp_path: Path, part: str, number: int) -> None:
    """Nobody here can say what another version's rules measured, nor whether there were such."""
    rules = {} if part == "study" else {"rules": replace(CURRENT, **{part: number})}
    header = replace(table.header, **({"study": number} if part == "study" else rules))
    with refused(BundleError, place=f"rules of {part}", got=str(number), remedy="another version"):
        write_table(tmp_path / "unknown.zip", header, table.networks, table.trainings)


def test_rows_that_do_not_suit_each_other_are_refused(table: SpaceTable, tmp_path: Path) -> None:
    """A manifest can be written again; what follows from other rows is compared all the same."""
    first, *others = table.trainings
    assert first.full is not None
    wrong = replace(first, full=replace(first.full, epoch=1 + first.full.epoch % 4))
    network = replace(table.networks[1], genome={**(table.networks[1].genome or {}), "hidden": 999})
    for networks, trainings, kind in (
        (table.networks, others, BundleError),
        (table.networks, [wrong, *others], BundleError),
        ((replace(table.networks[0], sha256="0" * 64), *table.networks[1:]), table.trainings, BundleError),
        ((table.networks[0], network, *table.networks[2:]), table.trainings, DivergenceError),
    ):
        with pytest.raises(kind):
            verify_table(write_table(tmp_path / "wrong.zip", table.header, networks, trainings))


def _with_member(table: SpaceTable, path: Path, name: str, data: bytes) -> Path:
    """Write a table with another member, and the manifest of it."""
    members = {**_members(table.path), name: data}
    del members[MANIFEST]
    manifest = "".join(f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in sorted(members.items()))
    path.write_bytes(packed({**members, MANIFEST: manifest.encode()}))
    return path


def _with_first(table: SpaceTable, **changes: Any) -> list[TableTraining]:
    """Change the first training of a table."""
    first, *others = table.trainings
    assert first.full is not None
    return [replace(first, full=replace(first.full, **changes)), *others]


def test_scores_that_contradict_each_other_are_refused(table: SpaceTable, tmp_path: Path) -> None:
    """Whoever writes a manifest anew cannot state an accuracy that the confusion has not, or one training for three."""
    full = table.trainings[0].full
    assert full is not None
    assert full.confusion is not None
    fewer = ((full.confusion[0][0] + 1, *full.confusion[0][1:]), *full.confusion[1:])
    losses = (-0.1, *full.training.validation_losses[1:])
    seeds = (table.header.seeds[0],) * 3
    copied = [replace(row, full=table.trainings[3 * row.network].full) for row in table.trainings]
    wrong = 1 - full.metrics["accuracy"]
    right = tuple(tuple(200 * (own == other) for other in range(7)) for own in range(7))
    perfect = {**full.metrics, "accuracy": 1.0, "macro_f1": 1.0, "cross_entropy": 1.95}
    one_class = ((1400, *[0] * 6), *[(0,) * 7] * 6)
    sure = {"accuracy": 1.0, "macro_f1": 1.0, "cross_entropy": 0.1}
    assert full.kept is not None
    other = table.trainings[3].full
    assert other is not None
    assert other.kept is not None
    first_two = (table.networks[0].profile, table.networks[1].profile)
    assert first_two[0] is not None
    assert first_two[1] is not None
    assert first_two[0].parameters != first_two[1].parameters
    trained = full.training
    for header, trainings, place in (
        (table.header, _with_first(table, metrics={**full.metrics, "accuracy": 0.99}), "metrics.accuracy"),
        (table.header, _with_first(table, metrics={**full.metrics, "cross_entropy": -0.1}), "metrics.cross_entropy"),
        (
            table.header,
            _with_first(table, metrics={**full.metrics, "cross_entropy": 0.69 * wrong}),
            "metrics.cross_entropy",
        ),
        (table.header, _with_first(table, metrics=perfect, confusion=right), "metrics.cross_entropy"),
        (table.header, _with_first(table, metrics=sure, confusion=one_class), "trainings.jsonl, line 2"),
        (
            table.header,
            _with_first(table, kept=replace(full.kept, labels="0" * 64)),
            "trainings.jsonl, line 2",
        ),
        (table.header, _with_first(table, kept=None), "trainings.jsonl, line 1"),
        (
            table.header,
            _with_first(table, kept=replace(full.kept, predictions=other.kept.predictions)),
            "trainings.jsonl, line 4",
        ),
        *(
            (
                table.header,
                _with_first(table, training=replace(trained, **{digest: getattr(other.training, digest)})),
                "trainings.jsonl, line 4",
            )
            for digest in ("weights_sha256", "predictions_sha256")
        ),
        (
            table.header,
            _with_first(table, training=replace(trained, not_deterministic=("aten::x",))),
            "trainings.jsonl, line 1",
        ),
        (
            table.header,
            _with_first(table, training=replace(trained, validation_losses=(-0.0,) * 4), epoch=1),
            "trainings.jsonl, line 1",
        ),
        (table.header, _with_first(table, metrics={"accuracy": full.metrics["accuracy"]}), "metrics"),
        (table.header, _with_first(table, confusion=fewer), "confusion"),
        (
            table.header,
            _with_first(table, training=replace(full.training, validation_losses=losses), epoch=1),
            "trainings.jsonl, line 1",
        ),
        (replace(table.header, seeds=seeds), table.trainings, "seeds"),
        (table.header, copied, "trainings.jsonl, line 2"),
    ):
        with refused(BundleError, place=place):
            write_table(tmp_path / "forged.zip", header, table.networks, trainings)


def test_seeds_text_and_card_follow_from_the_rows(table: SpaceTable, tmp_path: Path) -> None:
    """Other seeds than the configuration's, another README, and a record that is written otherwise are seen."""
    others = replace(table.header, seeds=tuple(seed + 1 for seed in table.header.seeds))
    with refused(DivergenceError, place="seeds"):
        verify_table(write_table(tmp_path / "seeds.zip", others, table.networks, table.trainings))
    better = table.card.replace("MADE UP", "measured").encode()
    with refused(DivergenceError, place=CARD):
        verify_table(read_table(_with_member(table, tmp_path / "card.zip", CARD, better)))
    for name in ("table.json", "networks.jsonl", "trainings.jsonl"):
        wider = _members(table.path)[name].replace(b":", b": ", 1).replace(b": \n", b":\n")
        wider = wider if name.endswith("l") else wider.replace(b'": ', b'":  ', 1)
        with refused(BundleError, place=name):
            read_table(_with_member(table, tmp_path / f"{name}.zip", name, wider))
    lines = _members(table.path)["trainings.jsonl"]
    loss = str(table.header.trivial).encode()
    for name, text in (
        ("trainings.jsonl", lines.replace(b"\n", b"\r\n")),
        ("trainings.jsonl", lines.replace(b"\n", b"\r")),
        ("trainings.jsonl", lines[:-1]),
        ("trainings.jsonl", lines + b"\n"),
        ("trainings.jsonl", re.sub(rb'"cross_entropy":[\d.]+', b'"cross_entropy":1', lines, count=1)),
        ("trainings.jsonl", re.sub(rb'"cross_entropy":([\d.]+)', rb'"cross_entropy":\g<1>0', lines, count=1)),
        ("table.json", _members(table.path)["table.json"].replace(b'"trivial": ' + loss, b'"trivial": 2')),
    ):
        with refused(BundleError, place=name):
            read_table(_with_member(table, tmp_path / "written.zip", name, text))
    second = table.networks[1]
    for value in (16.0, 0):
        genome = {name: value if part == value else part for name, part in (second.genome or {}).items()}
        assert canonical(genome) != canonical(second.genome)
        networks = [table.networks[0], replace(second, genome=genome), *table.networks[2:]]
        with refused(DivergenceError, place="networks.jsonl, line 2"):
            verify_table(write_table(tmp_path / "genome.zip", table.header, networks, table.trainings))


def test_claims_in_a_card_are_plain_unless_markdown_obeys_them(table: SpaceTable) -> None:
    """So the first tables keep their README, and no text of a stranger becomes a link in it."""
    for name, is_plain in (("AMD EPYC (R) 7_b", True), ("[a](b)", False), ("https://b", False), ("<img>", False)):
        machine: dict[str, Json] = {"cpu": name}
        text = card(replace(table.header, machine=machine), table.networks)
        assert (f"Machine: {canonical(machine)}\n" in text) is is_plain
        assert (f"Machine: `{canonical(machine)}`\n" in text) is not is_plain


def test_data_of_a_table_are_those_of_its_settings(table: SpaceTable, tmp_path: Path) -> None:
    """Where header, task and configuration say the same they agree; what follows from settings of data is compared."""
    facts, task = table.header.data, table.header.task
    narrow = replace(task.contract, in_channels=1)
    for changes, place in (
        ({"task": replace(task, name="force")}, "task.name"),
        ({"data": replace(facts, in_channels=1)}, "task.contract"),
        ({"data": replace(facts, image_size=64), "task": replace(task, contract=narrow)}, "task.contract"),
        ({"data": replace(facts, names=facts.names[1:])}, "data.names"),
        ({"data": replace(facts, outputs=6)}, "data"),
        ({"trivial": -0.0}, "trivial"),
    ):
        with refused(BundleError, place=place):
            write_table(tmp_path / "forged.zip", replace(table.header, **changes), table.networks, table.trainings)
    train, validation, test = facts.counts
    colour = replace(facts, in_channels=1), replace(task, contract=narrow)
    for changes, place in (
        ({"data": replace(facts, counts=(train + 1, validation, test))}, "data.counts"),
        ({"data": replace(facts, counts=(train + 1, validation - 1, test))}, "data.counts"),
        ({"data": replace(facts, names=("0.1 mm", *facts.names[1:]))}, "data.names"),
        ({"data": replace(facts, selected=("data.images=700",))}, "data.selected"),
        ({"data": colour[0], "task": colour[1]}, "data.in_channels"),
    ):
        forged = write_table(tmp_path / "forged.zip", replace(table.header, **changes), table.networks, table.trainings)
        with refused(DivergenceError, place=place):
            verify_table(forged)


def test_baseline_that_the_grammar_cannot_read_is_an_error(table: SpaceTable, tmp_path: Path) -> None:
    """Of a table as of a configuration that is tabulated; no traceback."""
    source = "from torch import nn\n\n\nclass SingleLabelClassCNN(nn.Module):\n    pass\n"
    task, digest = replace(table.header.task, baseline=source), hashlib.sha256(source.encode()).hexdigest()
    networks = [replace(table.networks[0], source=source, sha256=digest), *table.networks[1:]]
    other = write_table(tmp_path / "other.zip", replace(table.header, task=task), networks, table.trainings)
    with refused(BundleError, place="task.baseline"):
        verify_table(other)
    with refused(ConfigError, place="task.baseline"):
        members_of(other.header.settings, task)


def test_profile_that_the_gate_does_not_give_is_seen(table: SpaceTable, tmp_path: Path) -> None:
    """Each network goes through the gate again; of a made-up table nothing does, and that is said."""
    assert "not compared" in measure_table(table, Progress())
    trained = replace(table.header, made_up=False)
    claimed = write_table(tmp_path / "claimed.zip", trained, table.networks, table.trainings)
    verify_table(claimed)
    assert "tacevo replay" in repr(tacevo.open_table(claimed.path))  # which measures nothing
    with refused(DivergenceError, place="networks.jsonl, line 1", got="another profile"):
        measure_table(claimed, Progress())
    older = replace(trained, rules=replace(trained.rules, probe=1))
    written = write_table(tmp_path / "older.zip", older, table.networks, table.trainings)
    assert "other rules" in measure_table(written, Progress())


def test_other_files_are_no_table(table: SpaceTable, tmp_path: Path, published: Path) -> None:
    """A published run is not taken for one, and is refused as one; nor is a table taken for a run."""
    assert not is_table(published / "run.zip")
    for path in (published / "run.zip", tmp_path / "absent.zip"):
        with refused(BundleError, expected="the table of a space"):
            read_table(path)
    with refused(RunError, got="the table of a space", remedy="tacevo.open_table"):
        tacevo.open(table.path)


@pytest.mark.parametrize("override", ["llm=grammar", "data=table"])
def test_only_a_space_of_networks_with_images_is_tabulated(tmp_path: Path, override: str) -> None:
    """The whole grammar has no end, and a table has no images."""
    settings = ["experiment=space", override, "data.root=x"] if override == "data=table" else [override]
    with pytest.raises(ConfigError, match=r"closed space|images"):
        tabulate(compose(settings), tmp_path / "x.zip", Progress())


def test_frames_hold_every_row(table: SpaceTable) -> None:
    """A row a network, a training and an epoch."""
    opened = tacevo.open_table(table.path)
    assert (len(opened.networks), len(opened.scores), len(opened.trainings)) == (9, 27, 27 * 4)
    assert opened.networks["depth"].isna().tolist() == [True] + [False] * 8
    assert opened.worth.groupby("epochs").size().tolist() == [len(FITNESS.ours)] * 4


def test_regret_is_of_runs_of_the_table(table: SpaceTable, tmp_path: Path, published: Path) -> None:
    """A run of other data is refused, and one whose networks are not in the table or failed."""
    opened = tacevo.open_table(table.path)
    other = tacevo.open(published / "run.zip")
    assert isinstance(other, tacevo.Run)
    with refused(RunError, got="of the fingerprint"):
        opened.regret(other)
    run = tacevo.open(_looked_up(table, tmp_path).path)
    assert isinstance(run, tacevo.Run)
    with refused(RunError, got="none"):
        opened.regret(tacevo.Run(run.place, replace(run.recorded, elites=())))
    best = opened.regret(run).network
    header = replace(table.header, data=replace(table.header.data, fingerprint=table.digest))
    rejection = Rejection(stage=Stage.train, reason=Reason.not_finite, detail="made up")
    failed = [replace(row, full=None, rejection=rejection) if row.network == best else row for row in table.trainings]
    partly = write_table(tmp_path / "failed.zip", header, table.networks, failed)
    with refused(RunError, place="run", got=f"network {best}"):
        tacevo.open_table(partly.path).regret(run)
    others = [row for row in table.trainings if row.network == 0]
    write_table(tmp_path / "fewer.zip", header, table.networks[:1], others)
    with refused(RunError, place="run", got="not in it"):
        tacevo.open_table(tmp_path / "fewer.zip").regret(run)


@pytest.mark.room("estimate")
def test_estimate_of_a_search_of_a_table_says_that_nothing_is_trained(table: SpaceTable, tmp_path: Path) -> None:
    """It asks for no image."""
    from tacevo.runs.estimate import describe_estimates, describe_time

    config = compose(["experiment=space", *TINY, "data=table", f"data.root={table.path}", "training.epochs=1"])
    assert "nothing is trained" in describe_time(config)
    assert "about 0" in describe_estimates([("job", config)]).splitlines()[2]


@pytest.mark.slow
def test_table_run_equals_a_real_run_decision_by_decision(tmp_path: Path) -> None:
    """Where both exist: with one seed, a search that trains takes the very decisions of one that looks up.

    A search's training of one epoch is the beginning of a full training of two under the same seed, bit for bit: the
    rules of both train alike, and test images are predicted by the chosen weights only.
    """
    images, store = "data.images=300", f"store.root={tmp_path / 'cache'}"
    made = compose(["experiment=space", *TINY, images, store, "training.epochs=2"])
    table = tabulate(made, tmp_path / "table.zip", Progress())
    assert tabulate(made, tmp_path / "again.zip", Progress()).digest == table.digest
    assert len(table.networks) == 9
    assert not table.failures
    verify_table(table)
    assert measure_table(table, Progress()).endswith("verdicts and profiles are as recorded")
    refusal = Rejection(stage=Stage.probe, reason=Reason.too_many_flops, detail="")
    forged = replace(table.networks[1], profile=None, rejection=refusal)
    networks, rows = [table.networks[0], forged, *table.networks[2:]], [r for r in table.trainings if r.network != 1]
    with refused(DivergenceError, place="networks.jsonl, line 2"):
        measure_table(write_table(tmp_path / "refused.zip", table.header, networks, rows), Progress())
    assert "3 of 9 trainings" in retrain_table(table, 3, 1, None, Progress())
    for epochs in (1, 2):
        folder = tmp_path / str(epochs)
        looked_up = _looked_up(table, folder, f"training.epochs={epochs}")
        settings = ["experiment=space", *TINY, images, store, f"training.epochs={epochs}", f"run.dir={folder / 'real'}"]
        search(compose(settings), Progress())
        real = read_run(folder / "real")
        digests = {"predictions", "weights"} if epochs == 1 else set()
        names = {"evaluation", *digests}
        ours, theirs = ([_without(line, names) for line in run.candidates] for run in (looked_up, real))
        assert ours == theirs
        assert looked_up.elites == real.elites


def _without(line: CandidateLine, names: set[str]) -> dict[str, object]:
    return {name: value for name, value in asdict(line).items() if name not in names}


@pytest.mark.slow
def test_row_that_was_edited_does_not_train_to_it(tmp_path: Path) -> None:
    """A loss that was never measured is found by training its row again."""
    single = ["llm.space.hidden=[256]", "llm.space.residual=[false]", "llm.space.dropout=[0]"]
    place = ["data.images=300", f"store.root={tmp_path}"]
    made = compose(["experiment=space", *TINY, *single, *place, "training.epochs=1"])
    table = tabulate(made, tmp_path / "table.zip", Progress())
    first, *others = table.trainings
    assert first.full is not None
    training = replace(first.full.training, validation_losses=(0.1,))
    names = replace(table.header, data=replace(table.header.data, names=("0.1 mm", *table.header.data.names[1:])))
    renamed = write_table(tmp_path / "renamed.zip", names, table.networks, table.trainings)
    with refused(DivergenceError, place="data.names"):
        retrain_table(renamed, 1, 1, None, Progress())
    forged = [replace(first, full=replace(first.full, training=training)), *others]
    with pytest.raises(DivergenceError, match="validation_losses"):
        retrain_table(
            write_table(tmp_path / "forged.zip", table.header, table.networks, forged), None, 1, None, Progress()
        )


@pytest.mark.slow
def test_size_of_a_test_is_of_sweeps_of_the_table(table: SpaceTable, tmp_path: Path) -> None:
    """An arm is compared with itself under other seeds, two of four here; two seeds never tell anything apart."""
    settings = ["experiment=space", *TINY, "data=table", f"data.root={table.path}", "training.epochs=1"]
    settings += ["search.generations=0", f"store.root={tmp_path}", "ablation=none", "seed=0,1,2,3"]
    swept = tacevo.open(sweep(settings, str(tmp_path / "sweep"), Progress())[0])
    assert isinstance(swept, tacevo.Sweep)
    rates = tacevo.open_table(table.path).size_and_power(swept, seeds=2)
    assert rates["sweeps"].eq(1).all()
    assert rates["rejected"].eq(0).all()
    assert {*rates["arm"], *rates["against"]} == {"none"}
    with refused(ConfigError, place="seeds", got="3"):
        tacevo.open_table(table.path).size_and_power(swept, seeds=3)
    with refused(ConfigError, place="run", expected="one run"):
        tacevo.open_table(table.path).regret(swept)  # type: ignore[arg-type]
    with refused(ConfigError, place="sweep", got="<run"):
        tacevo.open_table(table.path).size_and_power(swept.runs[0], seeds=2)  # type: ignore[arg-type]
    other = made_up_table(tmp_path / "other.zip", *TINY, *SIZES, failing=3)
    with refused(RunError, got="of the fingerprint"):
        tacevo.open_table(other.path).size_and_power(swept, seeds=2)
