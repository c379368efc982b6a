"""Promise: each choice of what a model is told, and of how it answers, can be tried with the grammar, and replays.

The grammar makes nothing of what it is told, so each of these searches finds the networks of the search without it.
"""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from smallest import ARCHIVES, TOUCHES, UNTRACKED

from tacevo.cli.app import main
from tacevo.gate.patches import patched
from tacevo.llm.grammar.edits import edits
from tacevo.results.run import read_run
from tacevo.storage.canonical import content_hash, value_at
from tacevo.storage.store import Store

SEARCH = [
    *("search", *TOUCHES, *ARCHIVES, UNTRACKED, "llm=grammar", "llm.slip_rate=0.3", "store.root=cache"),
    *("search.generations=3", "search.candidates=5", "search.initial=2", "proposals.mutation_probability=0.6"),
]

#: Each choice, and all together.
TOLD = {
    "fitness": ["prompts.tells=[fitness]"],
    "shuffled": ["prompts.tells=[shuffled]"],
    "failures": ["prompts.tells=[failures]"],
    "best": ["prompts.tells=[best]"],
    "notes": ["prompts.tells=[notes]"],
    "edit": ["prompts.answer=edit"],
    "all": ["prompts.tells=[fitness,failures,best,notes]", "prompts.answer=edit"],
}

#: Searches with several models, which other answers are drawn for.
SEVERAL = {
    "weights": ["llm.models={grammar-2: 1, grammar-2-b: 3}"],
    "bandit": ["llm.models=[grammar-2,grammar-2-b]", "llm.choice=bandit"],
    "repairs": ["prompts.answer=edit", "prompts.tells=[notes]", "proposals.repair_attempts=1"],
}


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Search without any of the choices; the others recall what was trained."""
    place = tmp_path_factory.mktemp("told")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        assert main([*SEARCH, "run.dir=plain"]) == 0
    return place


def requests(run: Path) -> dict[str, str]:
    """Return what was asked for each candidate of a run, by its id."""
    store = Store(run.parent / "cache", "completions")
    asked = {content_hash(entry.request): entry.request for entry in store.entries()}
    found = {line.id: asked[line.request] for line in read_run(run).answered if line.request is not None}
    return {name: str(value_at(request, ("messages", 0, "content"))) for name, request in found.items()}


@pytest.mark.few(4)
@pytest.mark.parametrize("name", [*TOLD, *SEVERAL])
def test_search_is_stopped_and_replayed_like_any_other(
    name: str, plain: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its ledger, cut anywhere, is written again to the same bytes, and a replay gives its digest."""
    monkeypatch.chdir(plain)
    choice = (TOLD | SEVERAL)[name]
    assert main([*SEARCH, *choice, f"run.dir={name}"]) == 0
    ledger = plain / name / "ledger.jsonl"
    whole = ledger.read_bytes()
    kept = whole.splitlines(keepends=True)
    ledger.write_bytes(b"".join(kept[: 2 * len(kept) // 3]))
    assert main([*SEARCH, *choice, f"run.dir={name}"]) == 0
    assert ledger.read_bytes() == whole
    assert main(["replay", name]) == 0
    assert read_run(plain / name).digest in capsys.readouterr().out
    if name in SEVERAL:
        return
    found, without = ([(line.id, line.source, line.fitness) for line in read_run(plain / one).candidates]
                      for one in (name, "plain"))  # fmt: skip
    assert found == without
    asked = {run: requests(plain / run) for run in (name, "plain")}
    assert any(asked[name][one] != asked["plain"][one] for one in asked["plain"])
    assert all(asked[name][one] == asked["plain"][one] for one in asked["plain"] if one < "g01")


def test_edits_take_a_part_of_the_tokens(plain: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the answers to the very same mutations."""
    monkeypatch.chdir(plain)
    assert main([*SEARCH, *TOLD["edit"], "run.dir=edit"]) == 0
    spent = [
        sum(read_run(plain / run).spent[line.id].output_tokens for line in read_run(plain / run).answered
            if line.operator == "mutation" and line.generation > 0)
        for run in ("edit", "plain")
    ]  # fmt: skip
    assert spent[0] < spent[1]


def test_table_and_summary_say_what_came_of_each_model(
    plain: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Asked, trained and inserted, as the ledger counts; a search with one model has neither."""
    monkeypatch.chdir(plain)
    assert main([*SEARCH, *SEVERAL["weights"], "run.dir=weights"]) == 0
    capsys.readouterr()
    run = read_run(plain / "weights")
    assert main(["tables", "plain", "weights", "-o", "written"]) == 0
    (table,) = (plain / "written").rglob("models.csv")
    rows = [line.split(",") for line in table.read_text().splitlines()]
    for row in rows[1:]:
        of = [line for line in run.answered if line.model == row[0]]
        assert [int(row[1]), int(row[2])] == [len(of), sum(line.fitness is not None for line in of)]
    assert {row[0] for row in rows[1:]} == {"grammar-2", "grammar-2-b"}
    assert main(["show", "weights"]) == 0
    assert "grammar-2-b" in capsys.readouterr().out


@given(st.data())
def test_edits_of_the_grammar_give_the_child(data: st.DataObject) -> None:
    """Whatever lines stand twice, are blank, or change side by side."""
    line = st.sampled_from(["a", "  a", "b", "", "c", "d"])
    old = data.draw(st.lists(line, min_size=1, max_size=14).filter(any))
    new = list(old)
    for _ in range(data.draw(st.integers(0, 4))):
        at = data.draw(st.integers(0, len(new)))
        new[at : at + data.draw(st.integers(0, 2))] = data.draw(st.lists(line, max_size=2))
    rest = [f"rest {number}" for number in range(60)]
    parent, child = "\n".join([*old, *rest]), "\n".join([*new, *rest])
    written = edits(parent, f"{child}\n")
    assert (patched(written, parent, "Net", cut_off=False) or written.rstrip("\n")) == child
