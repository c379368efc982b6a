"""Tables of motifs: how often each occurs, beside the paper's list, and how the best networks are built."""

from collections.abc import Mapping

from analysis.anatomy import Anatomy
from analysis.loading import TOP, Run
from analysis.motifs import count_motifs
from analysis.tables import Percent, Table, percent
from tacevo.plurals import listed

#: What the paper names as recurring in its best networks, by task. Its "4 to 5 layers in the head" are taken as a
#: head that is deeper than the baseline's.
PUBLISHED: Mapping[str, tuple[str, ...]] = {
    "force": (
        "spatial attention",
        "strided convolution for max pooling",
        "2 to 4 convolutional blocks",
        "1x1 convolution",
        "LeakyReLU",
        "narrower hidden layer",
    ),
    "grating": (
        "wider convolutions",
        "deeper head",
        "GELU",
        "residual connection",
        "no dropout",
        "BatchNorm in the head",
        "LayerNorm in the head",
    ),
}


def motifs_table(run: Run, anatomies: Mapping[str, Anatomy], *, top: int = TOP) -> Table:
    """Show how often each motif occurs, with those that the paper names for the task."""
    counts = count_motifs(run, anatomies, top=top)
    named = PUBLISHED.get(run.task, ())
    rows = tuple(
        (
            entry.motif,
            "yes" if entry.baseline else None,
            f"{entry.top} of {counts.top}",
            _share(entry.archive, counts.archive),
            _share(entry.trained, counts.trained),
            "yes" if entry.motif in named else None,
        )
        for entry in counts.found
        if entry.baseline or entry.archive or entry.trained or entry.motif in named
    )
    return Table(
        name=f"motifs_{run.task}",
        caption=f"Motifs of the networks of {run.name}.",
        columns=("motif", "baseline", f"top {counts.top}", "archive", "trained", "in the paper"),
        rows=rows,
        notes=(
            f"Top {counts.top}: the elites of the lowest validation loss, each source once, without the baseline.",
            f"Archive: of {counts.archive} elites. Trained: of {counts.trained} candidates from generation 1 on.",
            "A motif that is no more frequent among the best than among all that were trained explains nothing.",
            "In the paper: named there for the best networks of this task; its counts were not published.",
        ),
    )


def anatomies_table(run: Run, anatomies: Mapping[str, Anatomy], *, top: int = TOP) -> Table:
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


def _share(count: int, total: int) -> Percent | None:
    return percent(count / total if total else None)
