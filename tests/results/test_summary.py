"""Promise: a summary says what the ledger says, and can be written at any moment of a run."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import pytest
from fakes import TASK
from hand_runs import of_lines
from ledger_lines import ended, header, rejected, run_record, trained
from rendered import HOSTILE, skeleton
from syrupy.assertion import SnapshotAssertion

from tacevo.config.compose import compose
from tacevo.config.schema import RunConfig
from tacevo.costs import Spending
from tacevo.evolution.lines import GenerationLine, RepairedAnswer
from tacevo.evolution.run_files import Line
from tacevo.records import Operator, Reason, Stage
from tacevo.results.run import RecordedRun
from tacevo.results.summary import in_short, summarise

CONFIG = compose(["experiment=published_force", "seed=3"])

RUN = run_record(name="force-seed3-0123abcd", task=replace(TASK, name="force"))


def generation(number: int, *, trained: int, candidates: int, best: float, median: float | None) -> GenerationLine:
    """Make the line of a generation."""
    figures = {"trained": trained, "candidates": candidates, "best": best, "generation_median": median}
    return ended(number, **figures, coverage=0.02, prompt_coverage=0.01, qd_score=1.75)


def run_of(
    *lines: Line,
    elites: Sequence[str] = ("g01s00",),
    config: RunConfig = CONFIG,
    spent: Mapping[str, Spending] | None = None,
    trivial: float | None = None,
) -> RecordedRun:
    """Make a run, finished or not."""
    record, niches = replace(RUN, trivial=trivial), dict.fromkeys(elites, 0)
    return of_lines(header(), *lines, elites=niches, config=config, record=record, spent=spent)


def page_of(*lines: Line, elites: Sequence[str] = ("g01s00",), config: RunConfig = CONFIG) -> str:
    """Write the summary of a run."""
    return summarise(run_of(*lines, elites=elites, config=config))


LINES = (
    trained("g00s00", 0.5),
    trained("g00s01", 0.4),
    generation(0, trained=2, candidates=2, best=0.4, median=0.45),
    trained("g01s00", 0.1, operator=Operator.crossover),
    rejected("g01s01", "extract", "truncated"),
    rejected("g01s02", "extract", "no_class"),
    rejected("g01s03", "extract", "truncated"),
    rejected("g01s04", "train", "out_of_time"),
    generation(1, trained=1, candidates=5, best=0.1, median=0.1),
    rejected("g02s00", "probe", "bad_output"),
    generation(2, trained=0, candidates=1, best=0.1, median=None),
)


def test_summary_is_golden(recorded_text: SnapshotAssertion) -> None:
    """A whole summary; it calls each fitness one draw, and no improvement of one over another stands in it."""
    assert page_of(*LINES, elites=["g01s00", "g00s01"]) == recorded_text


@pytest.mark.parametrize("text", HOSTILE)
def test_text_of_a_stranger_is_text_in_the_summary(text: str) -> None:
    """Names of the run, of its task and model, of kernels, of data and of candidates."""

    def said(words: str) -> str:
        config = replace(CONFIG, llm=replace(CONFIG.llm, model=words))
        lines = (
            replace(trained("g00s00", 0.5, not_portable=(words,)), id=words),
            trained("g00s01", 0.4, not_deterministic=(words,)),
            generation(0, trained=2, candidates=2, best=0.4, median=0.45),
        )
        run = run_of(*lines, elites=[words, "g00s01"], config=config)
        record = replace(
            run.record,
            name=words,
            task=replace(run.record.task, name=words),
            data=replace(run.record.data, fingerprint=words),
            elsewhere=True,
        )
        return summarise(replace(run, record=record))

    assert skeleton(said(f"x {text} y")) == skeleton(said("word"))


def sent_back(*reasons: Reason) -> tuple[RepairedAnswer, ...]:
    """Make the answers before a candidate's last one, sent back for these reasons at the probe."""
    return tuple(RepairedAnswer(answer="0", stage=Stage.probe, reason=reason) for reason in reasons)


SPENT = {
    "g00s01": Spending(answers=1, input_tokens=1000, output_tokens=500, usd=0.25),
    "g01s00": Spending(answers=2, input_tokens=3000, output_tokens=1500, usd=0.5),
}

#: Runs that have something which `LINES` lack, and the words for it.
PECULIAR: list[tuple[RecordedRun, list[str]]] = [
    (
        run_of(*LINES, config=replace(CONFIG, archive=replace(CONFIG.archive, kind="best", kept=7))),
        ["has no niches, but places for the best 7."],
    ),
    (
        run_of(*LINES, config=replace(CONFIG, search=replace(CONFIG.search, training_flops=1e15))),
        ["The search ends where its trainings reach search.training_flops=1e+15."],
    ),
    (
        run_of(
            trained("g00s00", 0.5, not_portable=("asin", "sqrt")),
            trained("g00s01", 0.4, not_deterministic=("adaptive_avg_pool2d_backward_cuda",)),
            generation(0, trained=2, candidates=2, best=0.4, median=0.45),
            elites=["g00s01"],
        ),
        [
            "Bits depend on the CPU, even under portable numerics (docs/determinism.md): g00s00 (asin, sqrt).",
            "g00s01 (adaptive_avg_pool2d_backward_cuda).",
        ],
    ),
    (
        run_of(
            trained("g00s00", 0.5, captured=True),
            trained("g00s01", 0.4, captured=False),
            generation(0, trained=2, candidates=2, best=0.4, median=0.45),
            elites=["g00s01"],
        ),
        ["Trained step by step, since one step could not be recorded for all (docs/scale.md): g00s01."],
    ),
    # All stages together, by reason, and first answers only.
    (
        run_of(
            trained("g00s00", 0.5),
            generation(0, trained=1, candidates=1, best=0.5, median=0.5),
            rejected("g01s00", "policy", "redefines_module"),
            rejected("g01s01", "probe", "hidden_parameters"),
            rejected("g01s02", "probe", "redefines_module"),
            rejected("g01s03", "probe", "bad_output"),
            generation(1, trained=0, candidates=4, best=0.5, median=None),
            elites=["g00s00"],
        ),
        ["Rejected for misreporting themselves (docs/gate.md): 3 (redefines_module 2, hidden_parameters 1)."],
    ),
    # The gate's rate is the paper's: of 3 first answers 1 is left, although 2 candidates trained.
    (
        run_of(
            trained("g00s00", 0.5),
            trained("g00s01", 0.4),
            trained("g00s02", 0.3, repairs=sent_back(Reason.bad_output, Reason.not_finite)),
            rejected("g00s03", "extract", "no_class", repairs=sent_back(Reason.bad_output)),
            replace(generation(0, trained=2, candidates=4, best=0.3, median=0.4), repaired=1),
            elites=["g00s02"],
        ),
        [
            "Gate: 1 of 3 first answers trained (33.3 %); rejected: probe 2 (bad_output 2).",
            "2 answers were sent back, 3 times in all; 1 then passed the gate, and 1 of these trained",
            "| 0          | 2/4 + 1 repaired |",
        ],
    ),
    # A skipped candidate is no failure.
    (
        run_of(
            trained("g00s00", 0.5),
            trained("g01s00", 0.4),
            replace(trained("g01s01", 0.4), fitness=None, evaluation=None, status=None, skipped=True),
            replace(generation(1, trained=1, candidates=2, best=0.4, median=0.4), skipped=1),
            elites=["g01s00"],
        ),
        [
            "Gate: 2 of 2 first answers trained or skipped (100.0 %); rejected: none.",
            "(proposals.skipped): 1.",
            "| 1          | 1/2 (1 skipped) |",
        ],
    ),
    (
        run_of(*LINES, spent=SPENT),
        ["Cost: 3 answers, 4,000 + 2,000 tokens, 0.750 USD. That of 5 candidates is not in timings.jsonl.\n"],
    ),
    (
        run_of(*(replace(line, dropped=("temperature",)) if line == LINES[1] else line for line in LINES)),
        ["temperature was not sent with 1 of 7 requests: the model refuses it", "are what was planned."],
    ),
    (run_of(*LINES, trivial=0.3), ["every validation image can have: 0.300.", "; the trivial loss is 0.300."]),
]


@pytest.mark.parametrize(("run", "words"), PECULIAR)
def test_what_a_run_has_is_said_and_nothing_of_what_it_has_not(run: RecordedRun, words: list[str]) -> None:
    """What its table rests on, whose bits may differ, misreports, repairs, costs, settings not sent, trivial loss."""
    page, plain = summarise(run), page_of(*LINES)
    assert [word for word in words if word not in page or word in plain] == []


def test_run_without_a_generation_has_a_headline_only() -> None:
    """Before generation 0 is complete nothing was found, and the page says no more than what runs."""
    page = page_of(LINES[0], elites=[])
    assert page.startswith("# force-seed3-0123abcd\n\nTask force, seed 3")
    assert "##" not in page


def test_best_are_ranked_by_fitness_then_id() -> None:
    """The list holds the five best elites in order and, last, the baseline."""
    names = [f"g00s{number:02d}" for number in range(1, 8)]
    fitnesses = [0.3, 0.2, 0.2, 0.9, 0.1, 0.8, 0.7]
    elites = [trained(name, fitness) for name, fitness in zip(names, fitnesses, strict=True)]
    lines: list[Line] = [trained("g00s00", 0.5), *elites, generation(0, trained=8, candidates=8, best=0.1, median=0.4)]
    page = page_of(*lines, elites=names)
    rows = [line.split("|")[1].strip() for line in page.splitlines() if line.startswith("| g")]
    assert rows[:6] == ["g00s05", "g00s02", "g00s03", "g00s01", "g00s07", "g00s00"]


def test_baseline_among_the_best_is_listed_once() -> None:
    """A baseline that is still an elite stands in its place, and not a second time at the end."""
    lines: list[Line] = [trained("g00s00", 0.1), trained("g00s01", 0.2)]
    ends = generation(0, trained=2, candidates=2, best=0.1, median=0.15)
    page = page_of(*lines, ends, elites=["g00s00", "g00s01"])
    assert [line.split("|")[1].strip() for line in page.splitlines() if line.startswith("| g0")] == ["g00s00", "g00s01"]


def test_end_of_a_search_fits_one_screen() -> None:
    """On 80 columns, with room for the commands: size, winner, its worth, the best five, the gate's rate."""
    names = [f"g01s{number:02d}" for number in range(8)]
    ends = generation(1, trained=8, candidates=8, best=0.1, median=0.4)
    elites = [trained(name, 0.1 * at, operator=Operator.crossover) for at, name in enumerate(names, start=1)]
    run = run_of(*LINES[:3], *elites, rejected("g01s08", "extract", "truncated"), ends, elites=names)
    assert not run.shortfall
    told = in_short(run)
    assert told.rstrip() in summarise(run)
    assert "Best fitness 0.100 by g01s00; the best of generation 0 has 0.400, the baseline 0.500." in told
    assert "Each is one draw, the lowest loss of one seed, and the best is the lowest of many." in told
    assert [row.split("|")[1].strip() for row in told.splitlines() if row.startswith("| g")] == [*names[:5], "g00s00"]
    assert told.endswith("Gate: 9 of 10 first answers trained (90.0 %); rejected: extract 1 (truncated 1).\n")
    assert sum(max(1, math.ceil(len(line) / 80)) for line in told.splitlines()) <= 19


def test_end_of_a_search_that_asked_nobody_has_no_rate() -> None:
    """There are no first answers."""
    run = run_of(LINES[0], generation(0, trained=1, candidates=1, best=0.5, median=0.5), elites=["g00s00"])
    assert in_short(run).endswith("\n\nGate: no model was asked.\n")


@pytest.mark.parametrize("trivial", [0.1, 0.104])
def test_summary_of_a_search_at_chance_says_so_first(trivial: float) -> None:
    """And what to raise; the best beside baseline and trivial loss. Nothing is called the best."""
    run = run_of(*LINES, trivial=trivial)
    page = summarise(run)
    first = page.split("\n\n")[2]
    assert first.startswith("At chance: ")
    assert "training.epochs" in first
    assert f"the baseline 0.500; the trivial loss is {trivial:.3f}." in page
    assert f"every validation image can have: {trivial:.3f}." in page
    told = in_short(run)
    assert told.index("At chance: ") < told.index("Lowest fitness 0.100")
    assert "Best fitness" not in told


def test_summary_of_a_search_without_a_better_network_says_so() -> None:
    """The elite may be the baseline itself; a baseline alone is no search."""
    lines = [LINES[0], rejected("g00s01", "extract", "no_class")]
    page = page_of(*lines, generation(0, trained=1, candidates=2, best=0.5, median=0.5), elites=["g00s00"])
    assert page.split("\n\n")[2].startswith("Nothing beat the baseline. No answer could be used: ")
    alone = page_of(LINES[0], generation(0, trained=1, candidates=1, best=0.5, median=0.5), elites=["g00s00"])
    assert "Nothing beat" not in alone
    assert "Nothing beat" not in page_of(*LINES)
