"""Promise: a network is told by the instructions that led to it."""

from checkout import GOLDEN

from tacevo.bundles.open import opened
from tacevo.records import Operator
from tacevo.results.lineage import changes


def test_steps_lead_from_the_baseline_to_the_network() -> None:
    """Oldest first, each with the candidate that was asked so; the baseline has none, and neither has a stranger."""
    bundle = opened(GOLDEN / "demo.zip")
    run = bundle.read(bundle.folder)
    lines = {line.id: line for line in run.candidates}
    texts = {instruction.text.strip().rstrip(".") for instruction in run.record.task.instructions}
    for line in run.candidates:
        steps = changes(run, line.id)
        assert bool(steps) == bool(line.parents)
        walked = line
        for step in reversed(steps):
            asked, _, name = step.removesuffix(")").rpartition(" (")
            assert name == walked.id
            if walked.operator is Operator.crossover:
                assert asked == f"crossed with {walked.parents[-1]}"
            else:
                assert asked in texts
            walked = lines[walked.parents[0]]
    assert changes(run, "g00s00") == changes(run, "g99s99") == []
