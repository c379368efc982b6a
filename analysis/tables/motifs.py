"""The table of motifs: how often each occurs, beside the published counts."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from analysis.motifs.motifs import count_motifs, read_anatomies
from analysis.motifs.structure import Anatomy
from analysis.table import PValue, Table
from tacevo.parts.output import Output
from tacevo.profile import Profile
from tacevo.results.run import TOP, RecordedRun
from tacevo.text import counted, listed

if TYPE_CHECKING:
    from analysis.report.collection import Collection

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


class Motifs(Output):
    """Adds the table of motifs to a run whose networks' profiles are known."""

    def tables(self, run: "Collection", profiles: Mapping[str, Profile] | None) -> Sequence[Table]:
        """Make the table; none without profiles."""
        return () if profiles is None else (motifs_table(run.run, read_anatomies(run.run, profiles)),)


def motifs_table(run: RecordedRun, anatomies: Mapping[str, Anatomy], *, top: int = TOP) -> Table:
    """Show how often each motif occurs, with its p, beside the counts that the authors published for the task."""
    counts = count_motifs(run, anatomies, top=top)
    published = SUPPLEMENT.get(run.task, {})
    best, archive, evaluated = counts[["top_of", "archive_of", "evaluated_of"]].iloc[0]
    shown = counts[counts.baseline | (counts.evaluated > 0) | counts.motif.isin(list(published))].assign(
        has=lambda rows: rows.baseline.map({True: "yes", False: None}),
        variants=lambda rows: rows.motif.map(lambda name: _variants(published.get(name))),
    )
    without = {name: _variants(numbers) for name, numbers in published.items() if name not in set(counts.motif)}
    return Table.of(
        shown,
        {
            **{"motif": "motif", "baseline": "has"},
            **_columns(f"top {best}", "top"),
            **_columns("archive", "archive"),
            **{"evaluated": (_of, "evaluated", "evaluated_of"), "published variants": "variants"},
        },
        last=((name, *(None,) * 8, variants) for name, variants in without.items()),
        name="motifs",
        caption=f"Motifs of the networks of {run.name}.",
        notes=(
            f"Evaluated: the {evaluated} different networks that were trained, in any generation. Archive: "
            f"the {archive} of them that are elites. Top {best}: the elites of the lowest validation "
            "loss. The baseline is not counted.",
            "p: the chance of at least as many networks with the motif if the top, or the archive, were drawn at "
            "random from the evaluated networks (hypergeometric, one-sided); corrected after Holm over all "
            f"{counted(int(counts.top_p.count() + counts.archive_p.count()), 'count')} that have a p. Where all or "
            "none of the evaluated networks have a motif, there is nothing to test.",
            "A motif may be frequent in the archive because of the niches that it leads to. Networks descend from each "
            "other, so their motifs are not independent, as the test supposes.",
            f"Published variants: how many of {VARIANTS} have the change, and which, by the authors' supplement "
            "(repository LannWei/TacEvo, page index.html). It counts blocks of several convolutions, where we count "
            "convolutions, so its changes of blocks have rows of their own.",
        ),
    )


def _columns(head: str, group: str) -> dict[str, str | tuple[Any, ...]]:
    return {
        head: (_of, group, f"{group}_of"),
        f"p, {head}": (PValue, f"{group}_p"),
        f"p, Holm, {head}": (PValue, f"{group}_p_holm"),
    }


def _of(number: int, total: int) -> str:
    return f"{number} of {total}"


def _variants(numbers: Sequence[int] | None) -> str | None:
    return None if numbers is None else f"{len(numbers)} of {VARIANTS}: {listed(map(str, numbers))}"
