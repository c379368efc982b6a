"""The paper's motifs: what networks have that the baseline lacks or has otherwise, found in how they are built.

docs/motifs.md has the definitions.
"""

from collections.abc import Callable, Mapping
from typing import Any

import pandas as pd

from analysis.motifs.structure import Anatomy, read_anatomy
from analysis.statistics.tests import holm, hypergeometric_p
from tacevo.errors import RunError
from tacevo.profile import Profile
from tacevo.results.run import TOP, RecordedRun

#: Says whether a network has a motif: the network, then the baseline.
Rule = Callable[[Anatomy, Anatomy], bool]


def width_ratio(network: Anatomy, baseline: Anatomy) -> float:
    """Compare channels convolution by convolution, in order, as far as both networks have them; 1 without any."""
    pairs = list(zip(network.channels, baseline.channels, strict=False))
    before = sum(theirs for _, theirs in pairs)
    return sum(ours for ours, _ in pairs) / before if before else 1.0


#: Every motif that is looked for, in the order of the table.
MOTIFS: Mapping[str, Rule] = {
    "spatial attention": lambda ours, _: ours.has_spatial_attention,
    "strided convolution for max pooling": lambda ours, base: (
        ours.strided > base.strided and ours.max_pools < base.max_pools
    ),
    "wider convolutions": lambda ours, base: width_ratio(ours, base) > 1,
    "more convolutional blocks": lambda ours, base: ours.blocks > base.blocks,
    "fewer convolutional blocks": lambda ours, base: ours.blocks < base.blocks,
    "2 to 4 convolutional blocks": lambda ours, _: 2 <= ours.blocks <= 4,
    "1x1 convolution": lambda ours, _: ours.pointwise > 0,
    "deeper head": lambda ours, base: ours.head_depth > base.head_depth,
    "narrower hidden layer": lambda ours, base: 0 < ours.hidden < base.hidden,
    "LeakyReLU": lambda ours, _: "leaky_relu" in ours.activations,
    "GELU": lambda ours, _: "gelu" in ours.activations,
    "residual connection": lambda ours, _: ours.residuals > 0,
    "BatchNorm in the blocks": lambda ours, _: ("batch_norm", "blocks") in ours.norms,
    "BatchNorm in the head": lambda ours, _: ("batch_norm", "head") in ours.norms,
    "LayerNorm in the head": lambda ours, _: ("layer_norm", "head") in ours.norms,
    "no dropout": lambda ours, _: not ours.has_dropout,
}

#: The columns of counted motifs, and the type of each: whether the baseline has it; how many networks of each group
#: have it, of how many (the same in every row); the chance of at least as many if the group were drawn at random from
#: all evaluated networks, and the same after Holm's correction over all counts of the frame that have one. Where all or
#: none of the evaluated networks have a motif there is nothing to test.
COLUMNS = {"motif": "str", "baseline": "bool", "evaluated": "int64", "evaluated_of": "int64"} | {
    f"{group}{column}": dtype
    for group in ("top", "archive")
    for column, dtype in {"": "int64", "_of": "int64", "_p": "float64", "_p_holm": "float64"}.items()
}


def motifs_of(network: Anatomy, baseline: Anatomy) -> frozenset[str]:
    """Name the motifs of a network, measured against the baseline where a motif is a comparison."""
    return frozenset(name for name, has in MOTIFS.items() if has(network, baseline))


def read_anatomies(run: RecordedRun, profiles: Mapping[str, Profile]) -> dict[str, Anatomy]:
    """Read how every trained candidate of a run is built, by id, in the order of the run; profiles are by id, too.

    Raises:
        RunError: a trained candidate has no profile, or one without steps.
    """
    anatomies = {}
    for candidate in run.trained:
        profile = profiles.get(candidate.id)
        if profile is None or not profile.steps:
            raise RunError("no steps", place=f"{run.path}, {candidate.id}", expected="a recorded probe with its steps")
        anatomies[candidate.id] = read_anatomy(profile)
    return anatomies


def count_motifs(run: RecordedRun, anatomies: Mapping[str, Anatomy], *, top: int = TOP) -> pd.DataFrame:
    """Count the motifs of the best networks and of the archive, and test each count against all that was evaluated.

    The best networks are those of `Run.best`, at most `top`. Each source counts once, the baseline's nowhere.

    Returns:
        A row for each motif (`COLUMNS`).
    """
    baseline = anatomies[run.baseline.id]
    sources = {candidate.id: candidate.source for candidate in run.candidates}
    motifs = {sources[name]: motifs_of(anatomy, baseline) for name, anatomy in anatomies.items()}
    evaluated = motifs.keys() - {run.baseline.source}
    groups = {
        "top": {candidate.source for candidate in run.best(top)},
        "archive": {sources[elite.id] for elite in run.elites} & evaluated,
    }
    rows: list[dict[str, Any]] = []
    for name in MOTIFS:
        having = {source for source in evaluated if name in motifs[source]}
        row: dict[str, Any] = {"motif": name, "baseline": name in motifs[run.baseline.source]}
        row |= {"evaluated": len(having), "evaluated_of": len(evaluated)}
        for group, members in groups.items():
            row |= {group: len(members & having), f"{group}_of": len(members)}
        rows.append(row)
    # The p-values are one family, in the order of the rows, the top's first.
    family = [(row, group) for row in rows if 0 < row["evaluated"] < len(evaluated) for group in groups]
    for row, group in family:
        row[f"{group}_p"] = hypergeometric_p(
            row[group], drawn=row[f"{group}_of"], marked=row["evaluated"], population=len(evaluated)
        )
    p_values = [row[f"{group}_p"] for row, group in family]
    for (row, group), corrected in zip(family, holm(p_values) if family else (), strict=True):
        row[f"{group}_p_holm"] = corrected
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype(COLUMNS)
