"""Promise: what seeds chose is judged by other seeds, and a table's judge is of fresh ones, whole, and verified."""

import hashlib
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up import TINY, made_up_judge, made_up_table
from refusals import refused

import tacevo
from analysis.statistics.spaces import best_unseen_loss, unseen_loss, worth_by_epochs, worth_by_judge
from tacevo.cli.app import main
from tacevo.config.compose import compose
from tacevo.errors import BundleError, ConfigError, DivergenceError
from tacevo.records import Reason, Rejection, Stage, to_json
from tacevo.reproduce.space_table import retrain_table, verify_table
from tacevo.results.gene_model import put_first
from tacevo.results.space_table import find_table, read_table, write_table
from tacevo.results.table_records import JUDGE, MANIFEST, Header, SpaceTable, TableTraining
from tacevo.runs.progress import Progress
from tacevo.runs.seeds import training_seed
from tacevo.runs.session import search
from tacevo.runs.table_answers import recorded_seeds
from tacevo.storage.entries import ReadBudget
from tacevo.storage.store import Store
from tacevo.storage.zipfiles import packed, read_members
from tacevo.studies.judge import judge_table
from tacevo.studies.tabulate import tabulate
from tacevo.training.full import StoredPredictions
from tacevo.training.metrics import counted_metrics

SIZES = ("training.epochs=4",)

#: A space of 32 networks.
WIDER = ("llm.space.activation=[relu,gelu]", "llm.space.norm=[none,batch]")


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> SpaceTable:
    """Make up the table of a small space."""
    return made_up_table(tmp_path_factory.mktemp("table") / "space.zip", *TINY, *WIDER, *SIZES)


@pytest.fixture(scope="module")
def judged(table: SpaceTable) -> SpaceTable:
    """Make up a judge of it."""
    return made_up_judge(table.path.with_name("judged.zip"), table)


def _searched(table: SpaceTable, folder: Path, *more: str) -> tacevo.Run:
    place = [f"data.root={table.path}", f"run.dir={folder / 'run'}", f"store.root={folder / 'cache'}"]
    search(compose(["experiment=space", *TINY, *WIDER, "data=table", "training.epochs=3", *place, *more]), Progress())
    run = tacevo.open(folder / "run")
    assert isinstance(run, tacevo.Run)
    return run


def _with_loss(training: TableTraining, loss: float) -> TableTraining:
    assert training.full is not None
    full = training.full
    assert full.confusion is not None
    if loss == 0:  # which no wrong answer has
        images = [sum(row) for row in full.confusion]
        confusion = tuple(tuple(count if i == j else 0 for j in range(len(images))) for i, count in enumerate(images))
        full = replace(full, confusion=confusion, metrics={**full.metrics, **counted_metrics(confusion)})
    return replace(training, full=replace(full, metrics={**full.metrics, "cross_entropy": loss}))


def test_loss_is_of_the_seeds_that_did_not_choose() -> None:
    """By hand: the mean logarithm of the others; none left is an error, which no figure hides."""
    losses = [0.1, 0.4, 0.9]
    assert unseen_loss(losses, [0]) == pytest.approx(math.log(0.6), abs=1e-8)
    assert unseen_loss(losses, []) == pytest.approx(math.log(0.1 * 0.4 * 0.9) / 3, abs=1e-8)
    with pytest.raises(ValueError, match="all of them"):
        unseen_loss(losses, [0, 1, 2])


def test_best_network_is_judged_by_a_seed_that_did_not_choose_it() -> None:
    """By hand: each network is lucky under one seed; the lowest mean would take that luck for its own."""
    losses = [[0.1, 1.0, 1.0], [1.0, 0.2, 1.0], [0.9, 0.9, 0.9]]
    # by seeds 1 and 2 the second is best, which seed 0 judges as 1; by 0 and 2 the first, 1; by 0 and 1 the first, 1
    assert best_unseen_loss(losses) == 0
    assert best_unseen_loss([[0.5, 0.5], [2.0, 2.0]]) == pytest.approx(math.log(0.5), abs=1e-8)


def test_agreement_is_of_all_splits_of_the_seeds() -> None:
    """Each seed ranks once, and the others judge; what a seed says of itself counts nowhere."""
    rng = np.random.default_rng(0)
    losses, scores = rng.random((30, 3, 2)) + 0.1, rng.random((30, 3)) + 0.1
    rows = worth_by_epochs(losses, scores)
    assert rows is not None
    turned = worth_by_epochs(losses[:, [2, 0, 1]], scores[:, [2, 0, 1]])
    assert rows.equals(turned)
    own = worth_by_epochs(scores[:, :, None], scores)  # a fitness that is the test loss itself
    assert own is not None
    assert own["one_seed"].abs().max() < 0.4
    assert worth_by_epochs(losses[:, :1], scores[:, :1]) is None
    perfect = worth_by_judge(scores[:, :1, None], scores[:, :1])
    assert set(perfect["one_seed"]) == {1.0}


def test_model_puts_first_what_its_genes_say_and_not_luck(table: SpaceTable, tmp_path: Path) -> None:
    """A network that was lucky alone is not put first; of equal expectations the lower row comes first."""

    def loss(row: int) -> float:
        genome = table.networks[row].genome or {}
        return 0.2 if (genome.get("norm"), genome.get("activation")) == ("batch", "gelu") else 0.4

    lucky = next(row for row in range(1, 33) if loss(row) == 0.4)
    rows = [_with_loss(one, 0.3 if one.network == lucky else loss(one.network)) for one in table.trainings]
    header = table.header
    level = write_table(tmp_path / "level.zip", header, table.networks, rows)
    best = [row for row in range(1, 33) if loss(row) == 0.2]
    assert set(put_first(level, 8)) == set(best)
    even = [_with_loss(one, loss(one.network)) for one in table.trainings]
    assert put_first(write_table(tmp_path / "even.zip", header, table.networks, even), 99)[:8] == tuple(best)
    refusal = Rejection(stage=Stage.train, reason=Reason.not_finite, detail="")
    failed = [replace(one, full=None, rejection=refusal) if one.network == best[0] else one for one in even]
    left = put_first(write_table(tmp_path / "failed.zip", header, table.networks, failed), 99)
    assert set(left) == set(range(1, 33)) - {best[0]}  # and without the baseline's file, row 0


def test_judge_is_a_part_of_the_file_and_searches_know_the_table_as_before(
    table: SpaceTable, judged: SpaceTable, tmp_path: Path
) -> None:
    """The digest by which runs find it stays, its own is another; a table without one has the bytes that it had."""
    assert judged.judge is not None
    assert judged.digest == table.digest != judged.judge.digest
    verify_table(judged)
    again = write_table(tmp_path / "again.zip", judged.header, judged.networks, judged.trainings)
    assert again.path.read_bytes() == table.path.read_bytes()
    assert find_table(Path("space.zip"), table.digest, tmp_path / "run", judged.path) == judged.path
    runs = [_searched(one, tmp_path / one.path.stem) for one in (table, judged)]
    assert runs[0].digest == runs[1].digest
    rows = tacevo.open_table(judged.path).judge
    assert list(dict.fromkeys(rows["network"])) == list(put_first(table, 3))
    assert (len(rows), set(rows["seed"])) == (12, set(range(4)))
    assert list(rows.columns) == list(tacevo.open_table(judged.path).scores.columns)
    assert tacevo.open_table(table.path).judge.empty


def test_what_a_search_saw_never_judges_it(table: SpaceTable, judged: SpaceTable, tmp_path: Path) -> None:
    """Neither the loss nor the rank of its network moves with the test loss of the seed that chose it."""
    run = _searched(table, tmp_path)
    opened = tacevo.open_table(table.path)
    found = opened.regret(run)
    source = table.networks[found.network].source
    (seen, *unseen) = recorded_seeds(table, run.config.seed, source).values()
    assert seen == recorded_seeds(table, run.config.seed, source)[training_seed(run.config.seed, 0)]
    tests = opened.scores.pivot(index="network", columns="seed", values="cross_entropy").to_numpy(float)
    own = float(np.log(tests[found.network, unseen]).mean())
    assert opened.unseen_loss(found.network, seen=[seen]) == pytest.approx(own, abs=1e-8)
    assert found.loss == pytest.approx(own - best_unseen_loss(tests), abs=1e-8)
    assert found.rank == 1 + (np.log(tests[:, unseen]).mean(axis=1) < own - 1e-12).sum()
    by_fresh = tacevo.open_table(judged.path)
    fresh = by_fresh.judge.pivot(index="network", columns="seed", values="cross_entropy")
    first = int(fresh.index[0])
    value = float(np.log(fresh.loc[first].to_numpy(float)).mean())
    assert by_fresh.unseen_loss(first, seen=[0, 1, 2]) == pytest.approx(value, abs=1e-8)  # none of these chose
    for seeds in ([0, 1, 2], [7]):
        with refused(ConfigError, place="seen", remedy="tacevo judge"):
            opened.unseen_loss(0, seen=seeds)
    with refused(ConfigError, place="network"):
        opened.unseen_loss(999, seen=[])


def _judged_by_hand(table: SpaceTable, path: Path, fresh: Mapping[int, list[float | None]]) -> SpaceTable:
    """Write a table whose judge has these test losses of these networks; None is a training that failed."""
    header = replace(table.header, seeds=(901, 902))
    sound = [one for one in table.trainings if one.full is not None]
    refusal = Rejection(stage=Stage.train, reason=Reason.not_finite, detail="")
    rows = []
    for network, losses in fresh.items():
        for seed, loss in enumerate(losses):
            row = replace(_with_loss(sound[network * 3], loss or 0.0), seed=seed)
            full = row.full
            assert full is not None
            weights = hashlib.sha256(f"{network}, {seed}".encode()).hexdigest()
            training = replace(full.training, weights_sha256=weights, predictions_sha256=weights)
            assert full.kept is not None
            kept = replace(full.kept, predictions=weights)
            row = replace(row, full=replace(full, training=training, kept=kept))
            rows.append(replace(row, full=None, rejection=refusal) if loss is None else row)
    return write_table(path, table.header, table.networks, table.trainings, (header, rows))


def test_regret_is_by_one_kind_of_seeds(table: SpaceTable, tmp_path: Path) -> None:
    """By hand: the judge's alone where it trained the network with each, or else the recorded ones, as without it."""
    run = _searched(table, tmp_path)
    plain = tacevo.open_table(table.path).regret(run)
    own, (one, other) = plain.network, [row for row in (5, 6, 7) if row != plain.network][:2]
    fresh: dict[int, list[float | None]] = {own: [0.8, 0.9], one: [0.5, 0.7], other: [0.6, 0.6]}
    whole = tacevo.open_table(_judged_by_hand(table, tmp_path / "whole.zip", fresh).path).regret(run)
    # seed 1 puts `other` first, which seed 0 judges as 0.6; seed 0 puts `one` first, which seed 1 judges as 0.7
    expected = (math.log(0.8) + math.log(0.9) - math.log(0.6) - math.log(0.7)) / 2
    assert (whole.network, whole.rank) == (own, 3)
    assert whole.loss == pytest.approx(expected, abs=1e-8)
    for name, losses in (
        ("lacking", {one: fresh[one], other: fresh[other]}),
        ("failed", {**fresh, own: [0.8, None]}),
    ):
        judged = _judged_by_hand(table, tmp_path / f"{name}.zip", losses)
        assert tacevo.open_table(judged.path).regret(run) == plain


def test_all_who_judge_a_network_say_the_same(table: SpaceTable, tmp_path: Path) -> None:
    """The judge where it trained the network with each seed, or else the recorded seeds; of a loss of 0 minus infinity.

    A perfect network stops neither the model of the genes nor a regret.
    """
    rows = [_with_loss(one, 0.0) if one.network in {3, 4} else one for one in table.trainings]
    perfect = write_table(tmp_path / "perfect.zip", table.header, table.networks, rows)
    judged = _judged_by_hand(perfect, tmp_path / "judged.zip", {5: [0.8, 0.9], 6: [0.5, None], 7: [0.0, 0.3]})
    opened = tacevo.open_table(judged.path)
    problem = opened.as_problem()
    for row in range(1, 9):
        genes = dict(judged.networks[row].genome or {})
        assert problem.judge(genes, seen=[1]) == opened.unseen_loss(row, seen=[1])
    assert opened.unseen_loss(5, seen=[0, 1, 2]) == pytest.approx(math.log(0.8 * 0.9) / 2, abs=1e-8)
    assert opened.unseen_loss(6, seen=[1]) == tacevo.open_table(table.path).unseen_loss(6, seen=[1])
    assert opened.unseen_loss(3, seen=[1]) == opened.unseen_loss(7, seen=[1]) == -math.inf
    with refused(ConfigError, place="seen"):
        problem.judge(dict(judged.networks[6].genome or {}), seen=[0, 1, 2])
    assert set(put_first(perfect, 99)) == set(range(1, 33))
    assert not tacevo.open_table(perfect.path).worth.empty
    assert not opened.worth.empty
    zero = [_with_loss(one, 0.0) for one in table.trainings]
    every = write_table(tmp_path / "zero.zip", table.header, table.networks, zero)
    assert len(put_first(every, 99)) == 32
    opened = tacevo.open_table(every.path)
    assert opened.worth["one_seed"].isna().all()
    assert opened.regret(_searched(every, tmp_path / "zero"))[1:] == (0.0, 1)


@pytest.mark.parametrize("network", [True, -1, 999, 1.0, "1", None, [1]])
@pytest.mark.parametrize("has_judge", [True, False])
def test_other_networks_and_seeds_are_not_judged(
    table: SpaceTable, judged: SpaceTable, network: Any, has_judge: bool
) -> None:
    """A row and the rows of recorded seeds are whole numbers within their range, whoever judges."""
    opened = tacevo.open_table((judged if has_judge else table).path)
    with refused(ConfigError, place="network"):
        opened.unseen_loss(network, seen=[0])
    first = put_first(table, 1)[0]
    for seen in (None, 0, "0", [99], [-1], [True], [0.0], ["0"]):
        with refused(ConfigError, place="seen"):
            opened.unseen_loss(first, seen=seen)  # type: ignore[arg-type]
    of_numpy: Any = np.int64(first)
    assert opened.unseen_loss(of_numpy, seen=np.arange(2)) == opened.unseen_loss(first, seen={0, 1})


def test_worth_is_of_the_networks_of_some_genes(table: SpaceTable, judged: SpaceTable) -> None:
    """All, or those with given values; by the judge's seeds where it has such networks."""
    opened = tacevo.open_table(table.path)
    assert opened.worth.equals(opened.worth_of())
    assert not opened.worth.equals(opened.worth_of(norm="batch", activation="gelu"))
    by_fresh = tacevo.open_table(judged.path)
    assert not by_fresh.worth.equals(opened.worth)
    assert (set(by_fresh.worth["judged_by"]), set(opened.worth["judged_by"])) == ({"fresh"}, {"recorded"})
    lacking = next(row for row in range(1, 33) if row not in set(by_fresh.judge["network"]))
    genome = dict(table.networks[lacking].genome or {})
    pair = {name: value for name, value in genome.items() if name != "norm"}  # of which the judge has one at most
    assert set(by_fresh.worth_of(**pair)["judged_by"]) == {"recorded"}
    for wrong in ({"colour": "red"}, {"norm": "group"}):
        with refused(ConfigError, place="genes"):
            opened.worth_of(**wrong)


def _forged(judged: SpaceTable, path: Path, change: Callable[[Header, list[TableTraining]], object]) -> Path:
    """Write a table whose judge was changed; its manifest and card agree with it."""
    assert judged.judge is not None
    header, rows = judged.judge.header, list(judged.judge.trainings)
    header = found if isinstance(found := change(header, rows), Header) else header
    write_table(path, judged.header, judged.networks, judged.trainings, (header, rows))
    return path


def test_judge_that_does_not_suit_its_table_is_refused(judged: SpaceTable, tmp_path: Path) -> None:
    """A part of its trainings, rows of the table for its own, the table's seeds, another recipe or other data."""
    assert judged.judge is not None
    first = judged.judge.trainings[0]

    def copied(_: Header, rows: list[TableTraining]) -> None:
        full = next(one.full for one in judged.trainings if one.network == first.network)
        rows[0] = replace(first, full=full)

    def of_recipe(header: Header, _: list[TableTraining]) -> Header:
        training = header.config["training"]
        assert isinstance(training, dict)
        return replace(header, config={**header.config, "training": {**training, "learning_rate": 0.5}})

    def of_nobody(_: Header, rows: list[TableTraining]) -> None:
        rows[:] = [replace(row, network=999) for row in rows]

    for change in (
        lambda _, rows: rows.pop(),
        lambda _, rows: rows.clear(),
        copied,
        of_nobody,
        of_recipe,
        lambda header, _: replace(header, seeds=(*judged.header.seeds, 5)),
        lambda header, _: replace(header, data=replace(header.data, fingerprint="0" * 64)),
        lambda header, _: replace(header, made_up=False),
        lambda header, _: replace(header, trivial=9.0),
    ):
        with refused(BundleError, place=JUDGE):
            _forged(judged, tmp_path / "forged.zip", change)


def test_judge_of_other_networks_or_seeds_than_follow_is_seen(judged: SpaceTable, tmp_path: Path) -> None:
    """Whoever makes one can choose neither whom it judges, nor their order, nor its seeds."""

    def turned(_: Header, rows: list[TableTraining]) -> None:
        rows[:] = rows[4:8] + rows[:4] + rows[8:]

    def lacking(_: Header, rows: list[TableTraining]) -> None:
        del rows[:4]

    def with_baseline(header: Header, rows: list[TableTraining]) -> Header:
        rows[:] = [replace(row, network=each) for each in (*put_first(judged, 99), 0) for row in rows[:4]]
        weights = (hashlib.sha256(f"{number}".encode()).hexdigest() for number in range(len(rows)))
        for at, row in enumerate(rows):
            assert row.full is not None
            full, one = row.full, next(weights)
            kept = StoredPredictions(predictions=one, labels="f" * 64)
            training = replace(full.training, weights_sha256=one, predictions_sha256=one)
            rows[at] = replace(row, full=replace(full, training=training, kept=kept))
        return header

    for change in (turned, lacking, with_baseline, lambda header, _: replace(header, seeds=(5, 6, 7, 8))):
        path = _forged(judged, tmp_path / "forged.zip", change)
        with refused(DivergenceError, place=JUDGE):
            verify_table(read_table(path))


def test_judge_without_its_header_or_its_text_edited_is_refused(judged: SpaceTable, tmp_path: Path) -> None:
    """Members are compared with the manifest, and a part is not read as no judge."""
    members = read_members(judged.path, re.compile(".*"), ReadBudget(judged.path, judged.path.stat().st_size))
    for name in (f"{JUDGE}table.json", f"{JUDGE}trainings.jsonl"):
        edited = {**members, name: members[name].replace(b"e", b"f", 1)}
        lacking = {key: data for key, data in members.items() if key not in {name, MANIFEST}}
        lines = (f"{hashlib.sha256(data).hexdigest()}  {key}\n" for key, data in sorted(lacking.items()))
        lacking[MANIFEST] = "".join(lines).encode()
        for forged in (edited, lacking):
            (tmp_path / "forged.zip").write_bytes(packed(forged))
            with pytest.raises(BundleError):
                read_table(tmp_path / "forged.zip")


def test_command_refuses_what_makes_no_judge(
    table: SpaceTable, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A made-up table, other settings than a machine's, one seed, more networks than there are; nothing is written."""
    command = ["judge", str(table.path), "-o", str(tmp_path / "judged.zip")]
    assert main(command) == 2
    assert "made-up" in capsys.readouterr().err
    for part in ("0/2", "3/2", "2", "x/y"):
        assert main([*command, "--part", part]) == 2
        assert "--part" in capsys.readouterr().err
    trained = write_table(
        tmp_path / "trained.zip", replace(table.header, made_up=False), table.networks, table.trainings
    )
    given = {"networks": 3, "seeds": 2}
    for place, overrides, sizes in (
        ("training.learning_rate", ["training.learning_rate=0.1"], given),
        ("data.seed", ["data.seed=1"], given),
        ("--seeds", [], {**given, "seeds": 1}),
        ("--networks", [], {**given, "networks": 33}),
    ):
        with refused(ConfigError, place=place):
            judge_table(trained, overrides, tmp_path / "judged.zip", Progress(), **sizes)
    assert not (tmp_path / "judged.zip").exists()


def test_no_table_and_no_judge_is_lost_to_another_judge(table: SpaceTable, judged: SpaceTable, tmp_path: Path) -> None:
    """What stands at the target is replaced by a judge with its networks and seeds, or more, of the same table."""
    assert judged.judge is not None

    def trained(name: str, of: SpaceTable, judge: SpaceTable | None = None) -> SpaceTable:
        real = replace(of.header, made_up=False)
        part = None if judge is None else (replace(judge.header, made_up=False), judge.trainings)
        return write_table(tmp_path / name, real, of.networks, of.trainings, part)

    rows, full = trained("table.zip", table), trained("judged.zip", judged, judged.judge)
    others = trained("others.zip", made_up_table(tmp_path / "made_up.zip", *TINY, *SIZES))
    before = {path: path.read_bytes() for path in (full.path, others.path)}
    fewer, other = ((full.path, *sizes) for sizes in ((2, 4), (3, 3), (2, 9), (9, 2))), (others.path, 9, 9)
    for path, networks, seeds in (*fewer, other):
        for one in (rows, full):
            for parts in (1, 2):
                with refused(ConfigError, place=f"-o {path}", remedy="-o"):
                    judge_table(one, [], path, Progress(), networks=networks, seeds=seeds, parts=parts)
    assert {path: path.read_bytes() for path in before} == before
    for target, networks, seeds in ((full.path, 3, 4), (full.path, 4, 5), (rows.path, 2, 2), (tmp_path / "new", 2, 2)):
        with refused(ConfigError, place="data.seed"):  # which is asked later
            judge_table(full, ["data.seed=1"], target, Progress(), networks=networks, seeds=seeds)


@pytest.mark.slow
def test_judge_is_trained_in_parts_and_trains_again_alike(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Parts write nothing; what is whole is written, verified, and each of its rows trains again, bit for bit."""
    store = f"store.root={tmp_path / 'cache'}"
    single = ["llm.space.hidden=[256]", "llm.space.residual=[false]"]
    made = compose(["experiment=space", *TINY, *single, "data.images=300", store, "training.epochs=1"])
    table, target = tabulate(made, tmp_path / "table.zip", Progress(), seeds=2), tmp_path / "judged.zip"
    before = table.path.read_bytes()
    sizes = ["--networks", "2", "--seeds", "2"]
    command = ["judge", str(table.path), store, "-o", str(target), *sizes]
    for part in ("1/2", "2/2"):
        assert main([*command, "--part", part]) == 0
    assert not target.exists()
    capsys.readouterr()
    assert main(command) == 0
    assert "4 of them recorded already" in capsys.readouterr().err
    judged = read_table(target)
    assert judged.judge is not None
    assert (judged.digest, len(judged.judge.trainings)) == (table.digest, 4)
    assert table.path.read_bytes() == before
    assert main(["replay", str(target), "--retrain", "1", "--store", str(tmp_path / "cache")]) == 0
    assert judged.judge.digest in capsys.readouterr().out
    first, *others = judged.judge.trainings
    forged = [_with_loss(first, 0.999), *others]
    header = judged.judge.header
    path = write_table(tmp_path / "forged.zip", judged.header, judged.networks, judged.trainings, (header, forged)).path
    judge = read_table(path).judge
    assert judge is not None
    with refused(DivergenceError, place=f"{JUDGE}trainings.jsonl, line 1"):
        retrain_table(judge, None, 1, str(tmp_path / "cache"), Progress())
    recorded = Store(tmp_path / "cache", "studies")
    (request,) = (entry.request for entry in recorded.entries() if entry.answer == {"full": to_json(first.full)})
    refusal = Rejection(stage=Stage.train, reason=Reason.not_finite, detail="")
    recorded.write(request, {"rejection": to_json(refusal)})
    capsys.readouterr()
    assert sorted(main([*command, "--part", part]) for part in ("1/2", "2/2")) == [0, 1]  # each says what failed of it
    assert capsys.readouterr().out.count(f"network {first.network}, seed {first.seed}: not_finite") == 1
    assert main(command) == 1
