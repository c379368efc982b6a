"""Promise: a network is told by the instructions that led to it, and by the layers that its code really has."""

import pytest
from checkout import GOLDEN

from tacevo.bundles.open import opened
from tacevo.records import Operator
from tacevo.results.lineage import changes, layer_changes


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


@pytest.mark.parametrize(
    ("after", "new", "gone"),
    [
        ("nn.Sequential(nn.Conv2d(3, 8, 3), nn.ReLU(), nn.Dropout(0.5))", [], []),
        ("nn.Sequential(nn.Conv2d(3, 8, 3), nn.ReLU(), nn.Dropout(0.4))", ["nn.Dropout(0.4)"], ["nn.Dropout(0.5)"]),
        ("(nn.GELU(), nn.Conv2d(3, 8, 3), nn.GELU())", ["nn.GELU() (2)"], ["nn.ReLU()", "nn.Dropout(0.5)"]),
        ("nn.Conv2d(3, 8, 3)(nn.ReLU()(nn.Dropout( 0.5 )(Own())))", ["Own()"], []),
        ("nn.Dropout(", [], []),
    ],
)
def test_layers_of_two_sources_are_compared(after: str, new: list[str], gone: list[str]) -> None:
    """Each as often as it is made, whatever holds it; what cannot be read is like everything."""
    before = "net = nn.Sequential(nn.Conv2d(3, 8, 3), nn.ReLU(), nn.Dropout(0.5))"
    assert layer_changes(before, f"net = {after}") == (new, gone)


def test_layers_of_the_best_network_contradict_its_instructions() -> None:
    """The demo's best network was last asked for a dropout of 0.6, and has 0.4."""
    bundle = opened(GOLDEN / "demo.zip")
    run = bundle.read(bundle.folder)
    sources = {line.id: str(line.source) for line in run.candidates}
    baseline, best = (run.directory.read_source(name, sources[name]) for name in ("g00s00", "g04s01"))
    assert "dropout rate to 0.6" in changes(run, "g04s01")[-1]
    new, gone = layer_changes(baseline, best)
    assert ("nn.Dropout(0.4)" in new, "nn.Dropout(0.5)" in gone) == (True, True)
