"""Motifs: what networks have that the baseline lacks or has otherwise, found in how they are built (docs/motifs.md)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from analysis.anatomy import Anatomy, read_anatomy
from analysis.attention import AttentionKind
from analysis.loading import TOP, Run
from tacevo.errors import RunError
from tacevo.records import Profile

#: Says whether a network has a motif: the network, then the baseline.
Rule = Callable[[Anatomy, Anatomy], bool]


@dataclass(frozen=True, slots=True, kw_only=True)
class Motif:
    """One property of a network."""

    name: str
    has: Rule


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """How often a motif occurs in a run."""

    motif: str
    baseline: bool
    #: Of the best networks (`Run.best`), of all elites, and of all trained candidates of generation 1 on.
    top: int
    archive: int
    trained: int


@dataclass(frozen=True, slots=True, kw_only=True)
class MotifCounts:
    """The motifs of a run, with how many networks were looked at."""

    top: int
    archive: int
    trained: int
    found: tuple[Found, ...]


def width_ratio(network: Anatomy, baseline: Anatomy) -> float:
    """Compare channels convolution by convolution, in order, as far as both networks have them; 1 without any."""
    pairs = list(zip(network.convolutions, baseline.convolutions, strict=False))
    before = sum(theirs.channels for _, theirs in pairs)
    return sum(ours.channels for ours, _ in pairs) / before if before else 1.0


def _attends(kind: AttentionKind) -> Rule:
    return lambda network, _: kind in network.attention


def _normalises(operation: str, place: str) -> Rule:
    return lambda network, _: (operation, place) in network.norms


def _activates(name: str) -> Rule:
    return lambda network, _: name in network.activations


def _ends_in(name: str) -> Rule:
    return lambda network, _: name in network.output


def _kernel(network: Anatomy) -> int:
    return max((convolution.kernel for convolution in network.convolutions), default=0)


def _first_hidden(network: Anatomy) -> int:
    return network.hidden[0] if network.hidden else 0


def _highest_rate(network: Anatomy) -> float:
    return max((rate for _, rate in network.dropouts), default=0.0)


#: Every motif that is looked for, in the order of the tables.
MOTIFS: tuple[Motif, ...] = tuple(
    Motif(name=name, has=has)
    for name, has in (
        ("spatial attention", _attends(AttentionKind.spatial)),
        ("channel attention", _attends(AttentionKind.channel)),
        ("self-attention", _attends(AttentionKind.self)),
        ("element-wise gate", _attends(AttentionKind.element)),
        (
            "strided convolution for max pooling",
            lambda ours, base: ours.strided > base.strided and ours.max_pools < base.max_pools,
        ),
        (
            "average pooling for max pooling",
            lambda ours, base: ours.average_pools > base.average_pools and ours.max_pools < base.max_pools,
        ),
        ("average and max pooled together", lambda ours, _: ours.global_pools == {"average", "max"}),
        ("wider convolutions", lambda ours, base: width_ratio(ours, base) > 1),
        ("narrower convolutions", lambda ours, base: width_ratio(ours, base) < 1),
        ("more convolutional blocks", lambda ours, base: ours.blocks > base.blocks),
        ("fewer convolutional blocks", lambda ours, base: ours.blocks < base.blocks),
        ("2 to 4 convolutional blocks", lambda ours, _: 2 <= ours.blocks <= 4),
        ("1x1 convolution", lambda ours, _: ours.pointwise > 0),
        ("depthwise convolution", lambda ours, _: any(layer.depthwise for layer in ours.convolutions)),
        ("larger kernel", lambda ours, base: _kernel(ours) > _kernel(base)),
        ("smaller kernel", lambda ours, base: _kernel(ours) < _kernel(base)),
        ("deeper head", lambda ours, base: ours.head_depth > base.head_depth),
        ("shallower head", lambda ours, base: ours.head_depth < base.head_depth),
        ("wider hidden layer", lambda ours, base: _first_hidden(ours) > _first_hidden(base)),
        ("narrower hidden layer", lambda ours, base: 0 < _first_hidden(ours) < _first_hidden(base)),
        ("LeakyReLU", _activates("leaky_relu")),
        ("GELU", _activates("gelu")),
        ("SiLU", _activates("silu")),
        ("ELU", _activates("elu")),
        ("residual connection", lambda ours, _: ours.residuals > 0),
        ("BatchNorm in the blocks", _normalises("batch_norm", "blocks")),
        ("GroupNorm in the blocks", _normalises("group_norm", "blocks")),
        ("InstanceNorm in the blocks", _normalises("instance_norm", "blocks")),
        ("LayerNorm in the blocks", _normalises("layer_norm", "blocks")),
        ("BatchNorm in the head", _normalises("batch_norm", "head")),
        ("LayerNorm in the head", _normalises("layer_norm", "head")),
        ("no dropout", lambda ours, _: not ours.dropouts),
        ("more dropout layers", lambda ours, base: len(ours.dropouts) > len(base.dropouts)),
        ("higher dropout rate", lambda ours, base: _highest_rate(ours) > _highest_rate(base)),
        ("lower dropout rate", lambda ours, base: 0 < _highest_rate(ours) < _highest_rate(base)),
        ("sigmoid output", _ends_in("sigmoid")),
        ("tanh output", _ends_in("tanh")),
        ("hardtanh output", _ends_in("hardtanh")),
        ("softmax output", _ends_in("softmax")),
    )
)


def motifs_of(network: Anatomy, baseline: Anatomy) -> frozenset[str]:
    """Name the motifs of a network, measured against the baseline where a motif is a comparison."""
    return frozenset(motif.name for motif in MOTIFS if motif.has(network, baseline))


def read_anatomies(run: Run, profiles: Mapping[str, Profile]) -> dict[str, Anatomy]:
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
    for candidate in run.candidates:
        if candidate.trained is not None:
            profile = profiles.get(candidate.id)
            if profile is None or not profile.steps:
                raise RunError(f"{candidate.id} of {run.path} has no recorded steps; probe its source anew")
            found[candidate.id] = read_anatomy(profile)
    return found


def count_motifs(run: Run, anatomies: Mapping[str, Anatomy], *, top: int = TOP) -> MotifCounts:
    """Count the motifs of the best networks against those of the whole archive and of all that was trained.

    Args:
        run: the run.
        anatomies: of its trained candidates, by id.
        top: how many of the best networks to count apart; see `Run.best`.
    """
    baseline = anatomies[run.baseline.id]
    motifs = {name: motifs_of(anatomy, baseline) for name, anatomy in anatomies.items()}
    elites, best = [elite.id for elite in run.elites], [candidate.id for candidate in run.best(top)]
    later = [it.id for it in run.candidates if it.trained is not None and it.generation > 0]

    def counted(names: Sequence[str], motif: Motif) -> int:
        return sum(motif.name in motifs[name] for name in names)

    return MotifCounts(
        top=len(best),
        archive=len(elites),
        trained=len(later),
        found=tuple(
            Found(
                motif=motif.name,
                baseline=motif.name in motifs[run.baseline.id],
                top=counted(best, motif),
                archive=counted(elites, motif),
                trained=counted(later, motif),
            )
            for motif in MOTIFS
        ),
    )
