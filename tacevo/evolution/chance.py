"""Whether anything was learned: losses beside the trivial loss, that of the best answer that looks at no image.

One and the same answer to every image reaches it (`tacevo.training.losses.trivial_loss`): the mean of the labels, or
the frequencies of the classes, of the very images that losses are measured on.
"""

from tacevo.rounding import significant

#: The part of the trivial loss by which a loss must lie below it; nearer ones are chance. Of the many losses of a
#: search on some fifty validation images, one or two lie a few per cent below it, though nothing was learned.
MARGIN = 0.05

#: The settings to raise where no network learned, and where none beat the baseline.
_LEARN = "Raise training.epochs{or_images}, or change training.learning_rate; then search.candidates or llm.model."
_FIND = (
    "Raise search.candidates or search.generations, or try another llm.model; then training.epochs{and_images} "
    "or training.learning_rate."
)

#: The words of these remedies about images, for a source that has the setting.
_IMAGES = {"or_images": " or data.images", "and_images": ", data.images"}

_USE = "No answer could be used: see the reasons of the gate, then try another llm.model or a larger llm.max_tokens."


def is_at_chance(best: float | None, trivial: float | None) -> bool:
    """Return whether the lowest of some losses is not below the trivial loss by more than `MARGIN` of it.

    False where either is not known, as in runs of earlier releases.
    """
    return best is not None and trivial is not None and best >= (1 - MARGIN) * trivial


def chance_in_words(trivial: float) -> str:
    """Say that no loss of some networks is below the trivial loss by the margin."""
    return (
        f"At chance: no network is more than {100 * MARGIN:g} % below the trivial loss, "
        f"{significant(trivial)} (the same answer to every image)."
    )


def shortfall(
    *, best: float, baseline: float | None, trivial: float | None, asked: bool, usable: bool, sized: bool = True
) -> str:
    """Say that a search learned nothing, or found nothing, and what to raise; empty where it did.

    Args:
        best: the lowest loss.
        baseline: that of the baseline; None where it is not known.
        trivial: the trivial loss; None where it is not known.
        asked: whether a model was asked for networks.
        usable: whether one of its answers was trained.
        sized: whether `data.images` may be a setting of its source; a source of a user's has others.
    """
    by_chance, is_beaten = is_at_chance(best, trivial), baseline is None or not best >= baseline
    sentences = [chance_in_words(trivial)] if by_chance and trivial is not None else []
    if asked and not is_beaten:
        sentences.append("Nothing beat the baseline.")
    if asked and not usable:
        sentences.append(_USE)
    elif asked and sentences:
        images = _IMAGES if sized else dict.fromkeys(_IMAGES, "")
        sentences.append((_LEARN if by_chance else _FIND).format(**images))
    return " ".join(sentences)
