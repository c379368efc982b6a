"""Motifs: what networks have that the baseline lacks or has otherwise, found in how they are built (docs/motifs.md)."""

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass

from analysis.motifs.attention import AttentionKind
from analysis.motifs.structure import Anatomy, read_anatomy
from analysis.statistics.tests import holm, hypergeometric_p
from tacevo.errors import RunError
from tacevo.profile import Profile
from tacevo.results.run import TOP, RecordedRun

#: Says whether a network has a motif: the network, then the baseline.
Rule = Callable[[Anatomy, Anatomy], bool]


@dataclass(frozen=True, slots=True, kw_only=True)
class Count:
    """How many networks of a group of the evaluated ones have a motif."""

    number: int
    #: Chance of at least as many if the group were drawn at random from all evaluated networks, in (0, 1]; None where
    #: all or none of these have the motif, so that there is nothing to test.
    p: float | None
    #: The same after Holm's correction over all counts of the run that have a p.
    p_holm: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """How often a motif occurs in a run."""

    motif: str
    baseline: bool
    #: Of the best networks (`Run.best`), and of all elites.
    top: Count
    archive: Count
    #: Of all evaluated networks.
    evaluated: int


@dataclass(frozen=True, slots=True, kw_only=True)
class MotifCounts:
    """The motifs of a run, with how many networks were looked at; each source counts once, the baseline's nowhere."""

    top: int
    archive: int
    #: Networks that were trained, in any generation.
    evaluated: int
    #: How many counts have a p: the family of Holm's correction.
    tested: int
    found: tuple[Found, ...]


def width_ratio(network: Anatomy, baseline: Anatomy) -> float:
    """Compare channels convolution by convolution, in order, as far as both networks have them; 1 without any."""
    pairs = list(zip(network.convolutions, baseline.convolutions, strict=False))
    before = sum(theirs.channels for _, theirs in pairs)
    return sum(ours.channels for ours, _ in pairs) / before if before else 1.0


def _kernel(network: Anatomy) -> int:
    return max((convolution.kernel for convolution in network.convolutions), default=0)


def _first_hidden(network: Anatomy) -> int:
    return network.hidden[0] if network.hidden else 0


def _highest_rate(network: Anatomy) -> float:
    return max((rate for _, rate in network.dropouts), default=0.0)


#: Every motif that is looked for, in the order of the tables.
MOTIFS: Mapping[str, Rule] = {
    "spatial attention": lambda ours, _: AttentionKind.spatial in ours.attention,
    "channel attention": lambda ours, _: AttentionKind.channel in ours.attention,
    "self-attention": lambda ours, _: AttentionKind.self in ours.attention,
    "element-wise gate": lambda ours, _: AttentionKind.element in ours.attention,
    "strided convolution for max pooling": lambda ours, base: (
        ours.strided > base.strided and ours.max_pools < base.max_pools
    ),
    "average pooling for max pooling": lambda ours, base: (
        ours.average_pools > base.average_pools and ours.max_pools < base.max_pools
    ),
    "average and max pooled together": lambda ours, _: ours.global_pools == {"average", "max"},
    "wider convolutions": lambda ours, base: width_ratio(ours, base) > 1,
    "narrower convolutions": lambda ours, base: width_ratio(ours, base) < 1,
    "more convolutional blocks": lambda ours, base: ours.blocks > base.blocks,
    "fewer convolutional blocks": lambda ours, base: ours.blocks < base.blocks,
    "2 to 4 convolutional blocks": lambda ours, _: 2 <= ours.blocks <= 4,
    "1x1 convolution": lambda ours, _: ours.pointwise > 0,
    "depthwise convolution": lambda ours, _: any(layer.depthwise for layer in ours.convolutions),
    "larger kernel": lambda ours, base: _kernel(ours) > _kernel(base),
    "smaller kernel": lambda ours, base: _kernel(ours) < _kernel(base),
    "deeper head": lambda ours, base: ours.head_depth > base.head_depth,
    "shallower head": lambda ours, base: ours.head_depth < base.head_depth,
    "wider hidden layer": lambda ours, base: _first_hidden(ours) > _first_hidden(base),
    "narrower hidden layer": lambda ours, base: 0 < _first_hidden(ours) < _first_hidden(base),
    "LeakyReLU": lambda ours, _: "leaky_relu" in ours.activations,
    "GELU": lambda ours, _: "gelu" in ours.activations,
    "SiLU": lambda ours, _: "silu" in ours.activations,
    "ELU": lambda ours, _: "elu" in ours.activations,
    "residual connection": lambda ours, _: ours.residuals > 0,
    "BatchNorm in the blocks": lambda ours, _: ("batch_norm", "blocks") in ours.norms,
    "GroupNorm in the blocks": lambda ours, _: ("group_norm", "blocks") in ours.norms,
    "InstanceNorm in the blocks": lambda ours, _: ("instance_norm", "blocks") in ours.norms,
    "LayerNorm in the blocks": lambda ours, _: ("layer_norm", "blocks") in ours.norms,
    "BatchNorm in the head": lambda ours, _: ("batch_norm", "head") in ours.norms,
    "LayerNorm in the head": lambda ours, _: ("layer_norm", "head") in ours.norms,
    "no dropout": lambda ours, _: not ours.dropouts,
    "more dropout layers": lambda ours, base: len(ours.dropouts) > len(base.dropouts),
    "higher dropout rate": lambda ours, base: _highest_rate(ours) > _highest_rate(base),
    "lower dropout rate": lambda ours, base: 0 < _highest_rate(ours) < _highest_rate(base),
    "sigmoid output": lambda ours, _: "sigmoid" in ours.output,
    "tanh output": lambda ours, _: "tanh" in ours.output,
    "hardtanh output": lambda ours, _: "hardtanh" in ours.output,
    "softmax output": lambda ours, _: "softmax" in ours.output,
}


def motifs_of(network: Anatomy, baseline: Anatomy) -> frozenset[str]:
    """Name the motifs of a network, measured against the baseline where a motif is a comparison."""
    return frozenset(name for name, has in MOTIFS.items() if has(network, baseline))


def read_anatomies(run: RecordedRun, profiles: Mapping[str, Profile]) -> dict[str, Anatomy]:
    """Read how every trained candidate of a run is built.

    Args:
        run: the run.
        profiles: by candidate id; those of trained candidates are needed, of others not looked at.

    Returns:
        By candidate id, in the order of the run.

    Raises:
        RunError: a trained candidate has no profile, or one without steps.
    """
    found = {}
    for candidate in run.trained:
        profile = profiles.get(candidate.id)
        if profile is None or not profile.steps:
            raise RunError("no steps", place=f"{run.path}, {candidate.id}", expected="a recorded probe with its steps")
        found[candidate.id] = read_anatomy(profile)
    return found


def count_motifs(run: RecordedRun, anatomies: Mapping[str, Anatomy], *, top: int = TOP) -> MotifCounts:
    """Count the motifs of the best networks and of the archive, and test each count against all that was evaluated.

    The best networks are those of `Run.best`, at most `top`.
    """
    baseline = anatomies[run.baseline.id]
    sources = {candidate.id: candidate.source for candidate in run.candidates}
    motifs = {sources[name]: motifs_of(anatomy, baseline) for name, anatomy in anatomies.items()}
    evaluated = motifs.keys() - {run.baseline.source}
    archive = {sources[elite.id] for elite in run.elites} & evaluated
    best = {candidate.source for candidate in run.best(top)}
    having = {name: {source for source in evaluated if name in motifs[source]} for name in MOTIFS}
    counts = _counted([(group, of) for of in having.values() for group in (best, archive)], len(evaluated))
    return MotifCounts(
        top=len(best),
        archive=len(archive),
        evaluated=len(evaluated),
        tested=sum(count.p is not None for count in counts),
        found=tuple(
            Found(
                motif=name,
                baseline=name in motifs[run.baseline.source],
                top=in_top,
                archive=in_archive,
                evaluated=len(of),
            )
            for (name, of), in_top, in_archive in zip(having.items(), counts[::2], counts[1::2], strict=True)
        ),
    )


def _counted(pairs: Sequence[tuple[Set[str | None], Set[str | None]]], population: int) -> list[Count]:
    """Count the networks of each group that have a motif, and correct all p-values as one family.

    Args:
        pairs: of a group, and of all evaluated networks with a motif; sources each.
        population: how many networks were evaluated.
    """
    p_values = [
        hypergeometric_p(len(group & of), drawn=len(group), marked=len(of), population=population)
        if 0 < len(of) < population
        else None
        for group, of in pairs
    ]
    tested = [p for p in p_values if p is not None]
    corrected = iter(holm(tested) if tested else ())
    return [
        Count(number=len(group & of), p=p, p_holm=None if p is None else next(corrected))
        for (group, of), p in zip(pairs, p_values, strict=True)
    ]
