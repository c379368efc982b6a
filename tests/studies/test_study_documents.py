"""Promise: a study is about the baseline and the best elites by validation loss, each source once."""

import pytest

from tacevo.errors import RunError
from tacevo.records import Json, Reason, Rejection, Stage, Training
from tacevo.studies.networks import networks_of, score_line
from tacevo.training.full import FullTraining


def candidate(name: str, source: str, fitness: float) -> dict[str, Json]:
    """Write a ledger line of a trained candidate."""
    return {"kind": "candidate", "id": name, "source": source, "fitness": fitness, "parameters": 1, "flops": 2}


LEDGER = [
    {"kind": "run"},
    candidate("g00s00", "base", 0.5),
    candidate("g00s01", "a", 0.4),
    candidate("g01s00", "b", 0.2),
    candidate("g01s01", "c", 0.4),
    candidate("g01s02", "b", 0.2),
    candidate("g01s03", "base", 0.1),
    {"kind": "candidate", "id": "g01s04", "stage": "probe", "reason": "crashed"},
    {"kind": "generation"},
]


def chosen(elites: list[str], count: int) -> list[tuple[str, str]]:
    """Give names and ids of the networks."""
    return [(network["name"], network["id"]) for network in networks_of(LEDGER, elites, count)]


def test_best_elites_come_after_the_baseline() -> None:
    """Lowest validation loss first, the earlier id on a tie, as many as were asked for."""
    elites = ["g01s01", "g01s00", "g00s01"]
    expected = [
        ("baseline", "g00s00"),
        ("variant 1", "g01s00"),
        ("variant 2", "g00s01"),
        ("variant 3", "g01s01"),
    ]
    assert chosen(elites, 3) == expected
    assert chosen(elites, 2) == expected[:3]
    assert chosen(elites, 9) == expected


def test_equal_sources_count_once() -> None:
    """Neither the baseline as an elite, nor a copy of it or of a better elite, takes a place."""
    elites = ["g00s00", "g01s03", "g01s02", "g01s00", "g01s01"]
    assert chosen(elites, 2) == [("baseline", "g00s00"), ("variant 1", "g01s00"), ("variant 2", "g01s01")]


@pytest.mark.parametrize("name", ["g01s04", "g09s09"])
def test_elite_that_was_not_trained_is_refused(name: str) -> None:
    """An archive that names what the ledger does not have was edited."""
    with pytest.raises(RunError, match=f"{name} has no fitness in the ledger.*restore archive.json"):
        networks_of(LEDGER, [name], 1)


def test_line_of_a_failed_training_has_its_reason_and_no_number() -> None:
    """Nobody can take it for a score."""
    verdict = Rejection(stage=Stage.train, reason=Reason.out_of_time, detail="over 2 s")
    line = score_line({"name": "variant 1", "id": "g01s00"}, 3, "key", verdict)
    assert (line["network"], line["seed"], line["reason"]) == ("variant 1", 3, "out_of_time")
    assert not {"metrics", "epoch", "validation_loss"} & line.keys()


def test_line_of_a_training_has_the_chosen_epoch() -> None:
    """Its validation loss is the one that chose it; operations without a deterministic form are named."""
    training = Training(
        train_losses=(1.0, 1.0),
        validation_losses=(0.25, 0.5),
        predictions_sha256="p",
        weights_sha256="w",
        not_deterministic=("pool",),
    )
    verdict = FullTraining(training=training, epoch=1, metrics={"accuracy": 0.5}, confusion=((1, 0), (1, 0)))
    line = score_line({"name": "baseline", "id": "g00s00"}, 0, "key", verdict)
    assert (line["epoch"], line["validation_loss"], line["confusion"]) == (1, 0.25, [[1, 0], [1, 0]])
    assert line["not_deterministic"] == ["pool"]
