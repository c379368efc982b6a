"""Arms compared answer by answer: only equal questions are compared, and what is said of them is in the ledgers."""

import math
from collections import Counter
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused
from smallest import SMALLEST, UNTRACKED

import tacevo
from analysis.sweeps.pairs import GENERATION, Pairs, distance, trigrams
from tacevo.cli.app import main
from tacevo.errors import ConfigError, RunError, StoreError
from tacevo.evolution.lines import CandidateLine
from tacevo.records import Request
from tacevo.results.run import read_run
from tacevo.storage.canonical import content_hash
from tacevo.storage.store import Store
from tacevo.typed import convert

pytestmark = pytest.mark.timeout(300)

#: One generation whose questions are asked twice each. A part of the answers is no network.
ONE_STEP = [
    *SMALLEST,
    UNTRACKED,
    *("search.generations=1", "search.candidates=12", "search.initial=2", "llm.slip_rate=0.2"),
    *("proposals.answers=2", "proposals.mutation_probability=1", "proposals.parents=trained"),
]

#: The provider answers by the model's name, too.
ARMS = "llm.model=drawn,another"

#: A parent; `{}` is its width.
PARENT = """
class ImageRegressionCNN(nn.Module):
    def __init__(self, in_channels=3, num_outputs=3):
        super().__init__()
        self.convolution = nn.Conv2d(in_channels, {}, kernel_size=3, stride=2)
        self.head = nn.Linear({}, num_outputs)

    def forward(self, x):
        return self.head(torch.relu(self.convolution(x)).mean((2, 3)))
"""


def _given(folder: Path) -> str:
    for width in (4, 8):
        (folder / f"width{width}.py").write_text(PARENT.format(width, width))
    return f"search.networks=[{folder}/width*.py]"


def _search(folder: Path, *settings: str) -> Path:
    where = ["seed=0,1", f"store.root={folder / 'cache'}", "--into", str(folder / "sweep")]
    assert main(["search", "-m", *ONE_STEP, *settings, *where]) == 0
    return folder / "sweep"


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a sweep of two models and two seeds, whose parents are given."""
    folder = tmp_path_factory.mktemp("pairs")
    return _search(folder, ARMS, _given(folder))


@pytest.fixture(scope="module")
def pairs(sweep: Path) -> Pairs:
    """Return the comparison of its arms."""
    opened = tacevo.open(sweep)
    assert isinstance(opened, tacevo.Sweep)
    return opened.pairs("llm.model=drawn")


def _asked(sweep: Path, arm: str) -> dict[tuple[int, int], CandidateLine]:
    """Return the answers of an arm by seed and slot."""
    return {
        (seed, line.slot): line
        for seed in (0, 1)
        for line in read_run(sweep / f"llm.model-{arm}-seed{seed}").candidates
        if line.generation == GENERATION
    }


def test_slots_of_a_question_ask_the_same_and_get_an_answer_each(sweep: Path, pairs: Pairs) -> None:
    """With `proposals.answers=2` two slots in a row differ in the draw alone, and questions differ from each other."""
    run = read_run(sweep / "llm.model-drawn-seed0")
    recorded = Store(run.stores, "completions").sound()
    requests = {
        content_hash(each.request): convert(Request, each.request, place="", error=StoreError) for each in recorded
    }
    asked = [requests[str(line.request)] for line in run.candidates if line.generation == GENERATION]
    questions = [replace(request, draw=0) for request in asked]
    assert questions[::2] == questions[1::2]
    assert len({request.draw for request in asked}) == len(asked)
    assert len({question.messages for question in questions}) > 1
    characters = [len(request.system) + len(request.messages[0].content) for request in asked]
    own = pairs.answers[(pairs.answers.arm == "llm.model=drawn") & (pairs.answers.seed == 0)]
    assert own.input_characters.tolist() == characters


def test_factor_is_that_of_the_ledgers(sweep: Path, pairs: Pairs) -> None:
    """A question counts by the mean of its pairs of which both trained; the factor is the geometric mean over these."""
    own, other = _asked(sweep, "another"), _asked(sweep, "drawn")
    questions: dict[object, list[float]] = {}
    for (seed, slot), line in own.items():
        fitness = line.fitness, other[seed, slot].fitness
        if None not in fitness:
            first, second = map(float, fitness)  # type: ignore[arg-type]  # neither is None
            questions.setdefault((line.parents, line.prompt), []).append(math.log(first / second))
    row = pairs.arms.loc["llm.model=another"]
    assert row.pairs == len(own) == 24
    assert row.questions == len(questions) < 12  # the provider slips, and a question may come twice
    assert row.factor == pytest.approx(math.exp(fmean(map(fmean, questions.values()))))
    assert row.factor_low < row.factor < row.factor_high
    assert row.trained == fmean(line.fitness is not None for line in own.values())


def test_diversity_is_that_of_the_sources(sweep: Path, pairs: Pairs) -> None:
    """The distance of a question is that of its two answers, where both trained; other questions do not count."""
    expected = []
    for seed in (0, 1):
        run = read_run(sweep / f"llm.model-drawn-seed{seed}")
        lines = [line for line in run.candidates if line.generation == GENERATION]
        for one, two in zip(lines[::2], lines[1::2], strict=True):
            if one.fitness is not None and two.fitness is not None:
                bags = [trigrams(run.directory.read_source(each.id, str(each.source))) for each in (one, two)]
                expected.append(distance(*bags))
    assert pairs.diversity is not None
    row = pairs.diversity.loc["llm.model=drawn"]
    assert row.questions == len(expected)
    assert row.text == pytest.approx(fmean(expected))
    assert 0 < row.operations <= 1


def test_sweep_with_given_networks_replays(sweep: Path) -> None:
    """The texts of given networks are in the run, so a replay needs no file of theirs."""
    assert main(["replay", str(sweep)]) == 0


def test_command_writes_its_tables(sweep: Path, tmp_path: Path) -> None:
    """`tacevo pairs` writes both tables in every format."""
    assert main(["pairs", str(sweep), "--output", str(tmp_path / "out")]) == 0
    written = {path.name for path in (tmp_path / "out").rglob("*.csv")}
    assert written == {"pairs.csv", "pairs_diversity.csv"}
    assert "# Tables\n\n- [pairs]" in (tmp_path / "out" / "index.md").read_text()


def test_arms_that_ask_nothing_alike_are_refused(tmp_path: Path) -> None:
    """Where no arm has a generation after generation 0, no two questions are equal, and nothing is compared."""
    opened = tacevo.open(_search(tmp_path, ARMS, "search.generations=0"))
    assert isinstance(opened, tacevo.Sweep)
    with refused(RunError, got="no two answers"):
        opened.pairs()


def test_arms_with_other_parents_are_paired_by_their_places(tmp_path: Path) -> None:
    """Arms that differ by their given networks are compared by slot where one asks for it; both have the baseline."""
    for name, widths in (("small", (4, 8)), ("large", (16, 32))):
        (tmp_path / name).mkdir()
        for number, width in enumerate(widths):
            (tmp_path / name / f"{number}.py").write_text(PARENT.format(width, width))
    folder = _search(tmp_path, f"search.networks=[{tmp_path}/small],[{tmp_path}/large]")
    sweep = tacevo.open(folder)
    assert isinstance(sweep, tacevo.Sweep)
    reference, other = sweep.arms
    with pytest.raises(RunError):
        sweep.pairs(reference)
    compared = sweep.pairs(reference, other_parents=True)
    own, others = (
        [
            (line.parents, line.prompt)
            for job in sweep.jobs.index[sweep.jobs.arm == arm]
            for line in read_run(folder / str(job)).candidates
            if line.generation == GENERATION
        ]
        for arm in (other, reference)
    )
    assert own == others
    of_baseline = sum(parents == ("g00s00",) for parents, _ in own)
    assert of_baseline > 0
    assert compared.shared == {other: of_baseline}
    assert compared.arms.loc[other].pairs == len(own) - of_baseline


def test_equal_requests_are_no_pair(tmp_path: Path) -> None:
    """Arms that ask by the very same requests have the same recorded answers, which say nothing of a difference."""
    same = _search(tmp_path, "prompts.policy=uniform,curiosity", "search.candidates=4")
    opened = tacevo.open(same)
    assert isinstance(opened, tacevo.Sweep)
    with refused(RunError, got="no two answers"):
        opened.pairs()


def test_unknown_reference_is_refused(sweep: Path) -> None:
    """The error lists the arms that there are."""
    opened = tacevo.open(sweep)
    assert isinstance(opened, tacevo.Sweep)
    with refused(ConfigError, place="reference", expected="llm.model=another"):
        opened.pairs("none")


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("import os\nclass TactileNet:\n    pass\n", "a network that the gate admits"),
        (None, "a file of a network"),
    ],
)
def test_networks_that_cannot_start_a_search_are_refused(source: str | None, expected: str, tmp_path: Path) -> None:
    """A file that the gate rejects, or that is not there, ends a search before its first training."""
    if source is not None:
        (tmp_path / "net.py").write_text(source)
    settings = [f"search.networks=[{tmp_path / 'net.py'}]", "search.initial=1", f"store.root={tmp_path / 'cache'}"]
    with refused(ConfigError, place="networks", expected=expected):
        tacevo.search(*ONE_STEP, *settings, f"run.dir={tmp_path / 'run'}")
    assert not (tmp_path / "run" / "ledger.jsonl").exists()


_BAGS = st.lists(st.integers(0, 5), max_size=12).map(Counter)


@given(one=_BAGS, other=_BAGS)
def test_distance_is_one_of_bags(one: Counter[int], other: Counter[int]) -> None:
    """It is in [0, 1], the same both ways, 0 for equal bags, and 1 for bags with nothing in common."""
    apart = distance(one, other)
    assert 0 <= apart <= 1
    assert apart == distance(other, one)
    assert (apart == 0) == (one == other)
    if one or other:
        assert (apart == 1) == (not set(one) & set(other))


def test_comments_and_layout_are_no_text() -> None:
    """Two texts that differ in these alone have a distance of 0."""
    assert trigrams("x = f(1,  2)  # two\n") == trigrams("# one\nx = f(\n    1,\n    2)\n")
