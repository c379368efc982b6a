"""Motifs are found by what networks do: every instruction of the libraries that makes one, and nothing beside it."""

from dataclasses import replace

import pandas as pd
import pytest
import yaml
from checkout import LIBRARY
from hand_runs import altered, closed, elite, rejected, run, trained
from motif_cases import CLASSES, anatomy_of, baseline, built, profile_of
from pandas.testing import assert_frame_equal
from refusals import refused
from statsmodels.stats.multitest import multipletests
from torch import nn

from analysis.motifs.motifs import MOTIFS, count_motifs, motifs_of, read_anatomies, width_ratio
from analysis.table import PValue
from analysis.tables.motifs import SUPPLEMENT, motifs_table
from tacevo.errors import RunError
from tacevo.llm.grammar.instructions import transform
from tacevo.llm.grammar.parsing import parse
from tacevo.llm.grammar.rendering import render
from tacevo.profile import Profile
from tacevo.randomness import stream
from tacevo.results.run import RecordedRun

pytestmark = pytest.mark.room("grammar")

#: The closed instructions that make one of the paper's motifs; all others add nothing to those of the baseline.
ADDS = {
    "widen_all": {"wider convolutions"},
    "widen_conv2": {"wider convolutions"},
    "hidden_384": {"narrower hidden layer"},
    "extra_hidden": {"deeper head"},
    "second_hidden": {"deeper head"},
    "drop_dropout": {"no dropout"},
    "lighter_head": {"narrower hidden layer", "no dropout"},
    "layer_norm_head": {"LayerNorm in the head"},
    "leaky_relu": {"LeakyReLU"},
    "gelu": {"GELU"},
    "strided": {"strided convolution for max pooling"},
    "batch_norm": {"BatchNorm in the blocks"},
    "norms": {"BatchNorm in the blocks", "LayerNorm in the head"},
    "spatial_attention": {"spatial attention"},
    "residual_1_3": {"residual connection"},
    "residual_conv2": {"residual connection"},
    "pointwise": {"1x1 convolution"},
}
OPEN_ENDED = {"refine", "rebalance", "faster"}
INSTRUCTIONS = [
    (task, entry["id"], entry["text"])
    for task in CLASSES
    for entry in yaml.safe_load((LIBRARY / task / "instructions.yaml").read_text(encoding="utf-8"))["mutations"]
]


@pytest.mark.parametrize("task", CLASSES)
def test_baseline_has_only_the_motif_of_its_depth(task: str) -> None:
    """Three blocks, two linear layers, nothing else."""
    assert motifs_of(baseline(task), baseline(task)) == {"2 to 4 convolutional blocks"}


@pytest.mark.parametrize(
    ("task", "name", "text"),
    [pytest.param(*entry, id=f"{entry[0]}-{entry[1]}") for entry in INSTRUCTIONS if entry[1] not in OPEN_ENDED],
)
def test_instruction_is_recognised_as_its_motif(task: str, name: str, text: str) -> None:
    """The grammar makes the change, and the change is found, alone."""
    parent = parse((LIBRARY / task / "baseline.py").read_text(encoding="utf-8"))
    child = built(render(transform(parent, text, stream(0, name), temperature=0.0)), CLASSES[task])
    before = motifs_of(baseline(task), baseline(task))
    assert motifs_of(anatomy_of(child), baseline(task)) == before | ADDS.get(name, set())


def test_published_motifs_are_looked_for() -> None:
    """Every one that the supplement counts, but for what it says of blocks."""
    assert {name for changes in SUPPLEMENT.values() for name in changes} - MOTIFS.keys() == {
        "another convolution in every block",
        "two blocks for three",
        "a fourth block",
    }


def test_width_is_compared_as_far_as_both_reach() -> None:
    """A fourth convolution makes a network deeper, not wider."""
    force = baseline("force")
    deeper, wider = (replace(force, channels=channels) for channels in ((*force.channels, 512), (64, 64, 128)))
    assert width_ratio(deeper, force) == 1
    assert width_ratio(wider, force) == pytest.approx(256 / 224)


def plain(activation: nn.Module, *, dropout: float = 0.0) -> Profile:
    """Trace a small network with one convolution and a hidden layer."""
    head = [nn.Flatten(), nn.Linear(8, 6), activation, nn.Dropout(dropout), nn.Linear(6, 3)]
    return profile_of(nn.Sequential(nn.Conv2d(3, 8, 3), nn.AdaptiveAvgPool2d(1), *head))


def searched() -> tuple[RecordedRun, dict[str, Profile]]:
    """Return a run of five trained candidates, three of which are elites, and their profiles."""
    slots = [trained(0, 0, 0.9), *(trained(1, slot, 0.1 * (slot + 1)) for slot in range(4)), rejected(1, 4)]
    elites = [
        elite(name, niche=niche, fitness=fitness)
        for niche, (name, fitness) in enumerate([("g00s00", 0.9), ("g01s00", 0.1), ("g01s01", 0.2)])
    ]
    profiles = {
        "g00s00": plain(nn.ReLU(), dropout=0.5),
        "g01s00": plain(nn.GELU()),
        "g01s01": plain(nn.GELU(), dropout=0.5),
        "g01s02": plain(nn.ReLU(), dropout=0.5),
        "g01s03": plain(nn.GELU(), dropout=0.5),
    }
    return run(slots, [closed(0), closed(1)], elites=elites), profiles


def counted(hand: RecordedRun, profiles: dict[str, Profile], top: int = 1) -> pd.DataFrame:
    """Count the motifs of a run, by their names."""
    return count_motifs(hand, read_anatomies(hand, profiles), top=top).set_index("motif")


def test_motifs_are_counted_in_top_archive_and_all() -> None:
    """The baseline is an elite, and not a network that the search came up with."""
    frame = counted(*searched())
    assert set(frame[["top_of", "archive_of", "evaluated_of"]].itertuples(index=False, name=None)) == {(1, 2, 4)}
    columns = frame[["baseline", "top", "archive", "evaluated"]]
    assert tuple(columns.loc["GELU"]) == (False, 1, 2, 3)
    assert tuple(columns.loc["no dropout"]) == (False, 1, 1, 1)
    assert tuple(columns.loc["LeakyReLU"]) == (False, 0, 0, 0)


def test_each_count_has_its_p_by_hand() -> None:
    """Of 4 networks 3 have GELU: the one of the top has it with a chance of 3/4, both of the archive with 3/6."""
    frame = counted(*searched())[["top_p", "archive_p"]]
    assert tuple(frame.loc["GELU"]) == (0.75, 0.5)
    assert tuple(frame.loc["no dropout"]) == (0.25, 0.5)


def test_every_count_of_a_table_is_one_family() -> None:
    """Two motifs with two counts each; what all or none of the networks have is not tested, and not corrected for."""
    frame = counted(*searched()).dropna()
    assert list(frame.index) == ["GELU", "no dropout"]
    expected = multipletests(frame[["top_p", "archive_p"]].to_numpy().ravel(), method="holm")[1]
    assert frame[["top_p_holm", "archive_p_holm"]].to_numpy().ravel() == pytest.approx(expected)


def test_equal_sources_are_one_network() -> None:
    """A copy of a candidate is not another draw."""
    hand, profiles = searched()
    copy = trained(1, 5, 0.1, source="g01s00")
    repeated = altered(hand, candidates=(*hand.candidates, copy))
    assert_frame_equal(counted(repeated, {**profiles, copy.id: profiles["g01s00"]}), counted(hand, profiles))


def test_archive_smaller_than_the_top_is_counted_whole() -> None:
    """Three elites, one of which is the baseline, are not four."""
    assert set(counted(*searched(), top=4).top_of) == {2}


def test_missing_profile_and_one_without_steps_are_rejected() -> None:
    """A profile of an older version shows no motif, which is not the same as having none."""
    hand, profiles = searched()
    without = {name: profile for name, profile in profiles.items() if name != "g01s02"}
    for faulty in (without, {**profiles, "g01s02": replace(profiles["g01s02"], steps=(), output=())}):
        with refused(RunError, place="runs/hand, g01s02", expected="a recorded probe with its steps"):
            read_anatomies(hand, faulty)


def test_table_stands_beside_the_paper() -> None:
    """Motifs that occur nowhere have no row, unless the authors published their count; a p stands beside each count."""
    hand, profiles = searched()
    rows = {row[0]: row[1:] for row in motifs_table(hand, read_anatomies(hand, profiles), top=1).rows}
    top, archive = (PValue(0.75), PValue(1.0)), (PValue(0.5), PValue(1.0))
    assert rows["GELU"] == (None, "1 of 1", *top, "2 of 2", *archive, "3 of 4", None)
    untested = ("0 of 1", None, None, "0 of 2", None, None, "0 of 4")
    assert rows["spatial attention"] == (None, *untested, "4 of 4: 1, 2, 3, 4")
    assert rows["two blocks for three"] == (*(None,) * 8, "2 of 4: 1, 2")
    assert "deeper head" not in rows
