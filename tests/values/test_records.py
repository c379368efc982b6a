"""Promise: records never change, compare by value, and come back from JSON as they were."""

import json
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import pytest
from asked import request

from tacevo import records
from tacevo.choices import Precision
from tacevo.config import schema
from tacevo.errors import StoreError
from tacevo.profile import Graph, Node, Profile, Step
from tacevo.records import (
    Completion,
    Contract,
    DataFacts,
    Delivery,
    Gpu,
    Kind,
    Limits,
    Loss,
    Price,
    Reason,
    Recipe,
    Rejection,
    Stage,
    Training,
    to_json,
    written,
)
from tacevo.storage.canonical import canonical
from tacevo.typed import convert

STEP = Step(
    op="conv2d",
    weighted=True,
    sources=((),),
    operands=((1, 3, 8, 8),),
    shape=(1, 16, 4, 4),
    kernel=(3, 3),
    stride=(2, 2),
    groups=1,
)

GRAPH = Graph(
    nodes=(Node(op="conv2d", weighted=True, width=16), Node(op="add", weighted=False, width=0)),
    edges=((0, 1),),
    channels=(16,),
    kernels=(3.0,),
    hidden=(),
)

RECIPE = Recipe(
    epochs=3, batch_size=32, learning_rate=0.001, optimiser="adam", limits=Limits(seconds=5.0, memory_mib=64)
)

TRAINING = Training(
    train_losses=(0.75, 0.5), validation_losses=(0.5, 0.1 + 0.2), predictions_sha256="ab", weights_sha256="cd"
)

#: One record of every class that is read back from a store.
READ_BACK = [
    Rejection(stage=Stage.probe, reason=Reason.out_of_time, detail="a minute was not enough"),
    GRAPH,
    STEP,
    Profile(parameters=448, flops=9000, modules=2, graph=GRAPH, steps=(STEP,), output=(0,)),
    TRAINING,
    Contract(
        class_name="A",
        kind=Kind.regression,
        loss=Loss.mse,
        in_channels=3,
        image_size=32,
        outputs=2,
        output_argument="num_outputs",
    ),
    RECIPE,
    replace(RECIPE, gpu=Gpu(model="NVIDIA H200", precision=Precision.tf32, memory_mib=8192)),
    DataFacts(
        fingerprint="ef",
        kind=Kind.regression,
        counts=(8, 1, 1),
        in_channels=3,
        image_size=32,
        outputs=2,
        names=("Fx", "Fy"),
    ),
    DataFacts(
        fingerprint="ef",
        kind=Kind.regression,
        counts=(8, 1, 4),
        in_channels=3,
        image_size=32,
        outputs=2,
        names=("Fx", "Fy"),
        groups=(0, 1, 0, 2),
    ),
]
GROUPED: dict[str, Any] = json.loads(json.dumps(to_json(READ_BACK[-1])))
ENUMS = [
    value
    for module in (records, schema)
    for value in vars(module).values()
    if isinstance(value, type) and issubclass(value, StrEnum) and value is not StrEnum
]


@pytest.mark.parametrize("record", READ_BACK, ids=lambda record: type(record).__name__)
def test_record_comes_back_from_json(record: Any) -> None:
    """What went through a file equals what was written, bit for bit."""
    assert convert(type(record), to_json(record), place="store", error=StoreError) == record


@pytest.mark.parametrize(
    "groups",
    [[0, 1], [0, 0, 0, 0, 0], [0, 2, 1, 3], [1, 1, 1, 1], [0, -1, 0, 0], [0, 0.0, 0, 1], [0, True, 0, 1], 1, "0"],
)
def test_groups_that_test_images_cannot_have_are_refused(groups: Any) -> None:
    """Too few, too many, with a gap, not integers; whoever forges them has to forge sound ones."""
    plain = {**GROUPED, "groups": groups}
    with pytest.raises(StoreError):
        convert(DataFacts, plain, place="run.json, data", error=StoreError)


def test_data_without_groups_are_written_as_before() -> None:
    """Nothing of them stands in a run's files, whose digests stay; each image counts once."""
    facts, grouped = (record for record in READ_BACK if isinstance(record, DataFacts))
    assert "groups" not in json.dumps(to_json(facts))
    assert (facts.units, grouped.units) == (1, 3)


@pytest.mark.parametrize("record", [record for record in READ_BACK if hasattr(record, "from_json")])
def test_record_reads_itself(record: Any) -> None:
    """A candidate's process reads its job without the library that checks what comes from outside."""
    assert record.from_json(json.loads(json.dumps(to_json(record)))) == record


def test_training_of_an_older_recording_is_read() -> None:
    """It names no operations without a deterministic form."""
    older = {key: value for key, value in to_json(TRAINING).items() if key != "not_deterministic"}
    assert convert(Training, older, place="store", error=StoreError) == TRAINING


@pytest.mark.parametrize("enum", ENUMS, ids=lambda enum: enum.__name__)
def test_names_of_choices_are_what_is_written(enum: type[StrEnum]) -> None:
    """Hydra reads members by their names and JSON holds their values, so the two are one."""
    assert [member.name for member in enum] == [member.value for member in enum]


def test_to_json_gives_plain_values() -> None:
    """Nested records become mappings, tuples lists, enums their values; scalars stay what they are."""
    assert to_json({Kind.regression: (RECIPE.limits, None, True, Stage.train)}) == {
        "regression": [{"seconds": 5.0, "memory_mib": 64}, None, True, "train"]
    }
    listed: Any = to_json([Stage.train])
    assert type(listed[0]) is str


def test_only_records_are_written() -> None:
    """What enters a hash is never silently nothing."""
    with pytest.raises(TypeError, match="dataclass"):
        written((1, 2))


def test_request_holds_all_that_changes_an_answer() -> None:
    """The key of a completion is the whole of its request, in this very form."""
    assert to_json(request("hello", settings=(("slip_rate", 0.05),))) == {
        "model": "model-x",
        "system": "Be brief.",
        "messages": [{"role": "user", "content": "hello"}],
        "temperature": 0.65,
        "max_tokens": 77,
        "draw": 1,
        "settings": [["slip_rate", 0.05]],
    }


#: An answer as it is recorded now.
NEW = Completion(
    text="class A: ...",
    model="m-1",
    stop_reason="end_turn",
    input_tokens=3,
    output_tokens=4,
    dropped=("temperature", "top_k"),
    delivery=Delivery.batch,
    price=Price(input_usd=0.25, output_usd=1.25, dated="2026-11-21", factor=0.5),
)

#: An answer as it was recorded before answers had a delivery and a price.
OLD = {"text": "class A: ...", "model": "m-1", "stop_reason": "end_turn", "input_tokens": 3, "output_tokens": 4}


def test_answers_of_any_age_are_read() -> None:
    """An older one came one by one, with every setting sent, at a price that is not known."""
    assert read(to_json(NEW)) == NEW
    old = read(OLD)
    assert (old.dropped, old.delivery, old.price, old.cost) == ((), Delivery.direct, None, None)


def read(answer: Any) -> Completion:
    """Read an answer as the stores do."""
    return convert(Completion, answer, place="answer", error=StoreError)


def test_ledger_sees_neither_delivery_nor_price() -> None:
    """What enters the ledger of an answer is what the ledgers of older runs hold, however it came and was paid."""
    assert NEW.content() == read(OLD).content() == OLD


def test_what_json_cannot_hold_is_left_to_the_writer_which_refuses_it() -> None:
    """A value of an unknown class is not guessed at: nothing of it enters a file."""
    with pytest.raises(TypeError, match="not JSON serializable"):
        canonical(to_json(Path("a")))
