"""Tables of motifs: how often each occurs, beside the published counts, and how the best networks are built."""

from collections.abc import Mapping, Sequence

from analysis.motifs.motifs import Count, count_motifs
from analysis.motifs.structure import Anatomy
from analysis.table import PValue, Table
from tacevo.results.run import TOP, RecordedRun
from tacevo.text import counted, listed

#: The variants of each task, by number, that have a change by the authors' supplement (docs/references.bib,
#: tacevo_supplement, appendices A and B). A change with the name of one of our motifs is that motif; a head of 4 or 5
#: layers is a deeper one. Others have no counterpart, because the supplement counts blocks, which may hold several
#: convolutions, and we count convolutions.
SUPPLEMENT: Mapping[str, Mapping[str, tuple[int, ...]]] = {
    "force": {
        "spatial attention": (1, 2, 3, 4),
        "strided convolution for max pooling": (1, 2, 3, 4),
        "1x1 convolution": (3,),
        "narrower hidden layer": (1, 2),
        "LeakyReLU": (1,),
        "another convolution in every block": (1, 2),
        "two blocks for three": (1, 2),
        "a fourth block": (4,),
    },
    "grating": {
        "wider convolutions": (1, 2, 3, 4),
        "deeper head": (1, 2, 3, 4),
        "GELU": (1, 3),
        "residual connection": (3, 4),
        "no dropout": (1, 2, 3, 4),
        "BatchNorm in the head": (1, 2, 3, 4),
        "LayerNorm in the head": (1, 2, 3, 4),
    },
}

#: Variants of each task in the supplement.
VARIANTS = 4


def motifs_table(run: RecordedRun, anatomies: Mapping[str, Anatomy], *, top: int = TOP) -> Table:
    """Show how often each motif occurs, with its p, beside the counts that the authors published for the task."""
    counts = count_motifs(run, anatomies, top=top)
    published = SUPPLEMENT.get(run.task, {})
    best = f"top {counts.top}"
    ours = {
        entry.motif: (
            "yes" if entry.baseline else None,
            *_cells(entry.top, counts.top),
            *_cells(entry.archive, counts.archive),
            f"{entry.evaluated} of {counts.evaluated}",
        )
        for entry in counts.found
        if entry.baseline or entry.evaluated or entry.motif in published
    }
    return Table(
        name=f"motifs_{run.task}",
        caption=f"Motifs of the networks of {run.name}.",
        columns=(
            *("motif", "baseline", best, f"p, {best}", f"p, Holm, {best}"),
            *("archive", "p, archive", "p, Holm, archive", "evaluated", "published variants"),
        ),
        rows=(
            *((name, *cells, _variants(published.get(name))) for name, cells in ours.items()),
            *((name, *(None,) * 8, _variants(numbers)) for name, numbers in published.items() if name not in ours),
        ),
        notes=(
            f"Evaluated: the {counts.evaluated} different networks that were trained, in any generation. Archive: "
            f"the {counts.archive} of them that are elites. Top {counts.top}: the elites of the lowest validation "
            "loss. The baseline is not counted.",
            "p: the chance of at least as many networks with the motif if the top, or the archive, were drawn at "
            "random from the evaluated networks (hypergeometric, one-sided); corrected after Holm over all "
            f"{counted(counts.tested, 'count')} that have a p. Where all or none of the evaluated networks have a "
            "motif, there is nothing to test.",
            "A motif may be frequent in the archive because of the niches that it leads to. Networks descend from each "
            "other, so their motifs are not independent, as the test supposes.",
            f"Published variants: how many of {VARIANTS} have the change, and which, by the authors' supplement "
            "(repository LannWei/TacEvo, page index.html). It counts blocks of several convolutions, where we count "
            "convolutions, so its changes of blocks have rows of their own.",
        ),
    )


def _cells(count: Count, total: int) -> tuple[str, PValue | None, PValue | None]:
    if count.p is None or count.p_holm is None:
        return f"{count.number} of {total}", None, None
    return f"{count.number} of {total}", PValue(count.p), PValue(count.p_holm)


def _variants(numbers: Sequence[int] | None) -> str | None:
    return None if numbers is None else f"{len(numbers)} of {VARIANTS}: {listed(map(str, numbers))}"


def anatomies_table(run: RecordedRun, anatomies: Mapping[str, Anatomy], *, top: int = TOP) -> Table:
    """Show how the baseline and the best networks are built."""
    named = [("baseline", run.baseline.id), *((best.id, best.id) for best in run.best(top))]
    columns = ("network", "convolutions", "1x1", "strided", "pooling", "head", "activations", "normalisation")
    return Table(
        name=f"anatomies_{run.task}",
        caption=f"How the baseline and the best networks of {run.name} are built.",
        columns=(*columns, "dropout", "attention", "residuals", "output"),
        rows=tuple(_row(name, anatomies[candidate]) for name, candidate in named),
        notes=(
            "Convolutions: output channels, with the kernel where it is not 3; head: features of its linear layers.",
        ),
    )


def _row(name: str, anatomy: Anatomy) -> tuple[str | int, ...]:
    pools = [
        f"{count} {kind}" for kind, count in (("max", anatomy.max_pools), ("average", anatomy.average_pools)) if count
    ]
    convolutions = [
        f"{layer.channels}{'' if layer.kernel == 3 else f' ({layer.kernel}x{layer.kernel})'}"
        for layer in anatomy.convolutions
    ]
    return (
        name,
        listed(convolutions),
        anatomy.pointwise,
        anatomy.strided,
        f"{listed(pools)}, then {listed(sorted(anatomy.global_pools))}",
        listed(map(str, anatomy.head)),
        listed(sorted(anatomy.activations)),
        listed(f"{operation} ({place})" for operation, place in sorted(anatomy.norms)),
        listed(f"{rate:g} ({place})" for place, rate in anatomy.dropouts),
        listed(sorted(anatomy.attention)),
        anatomy.residuals,
        listed(sorted(anatomy.output), nothing="free"),
    )
