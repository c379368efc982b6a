"""What the trainings of a search take, in FLOPs, and the bound on it that ends a search; pure."""

from collections.abc import Iterable
from dataclasses import dataclass

from tacevo.search.lines import CandidateLine


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """A bound on the trainings of a search."""

    #: What the search ends at, in FLOPs as `training_flops` counts them; > 0.
    flops: float
    #: Images in one epoch of a training, epochs of one, and trainings of a network.
    images: int
    epochs: int
    seeds: int = 1

    def is_spent(self, trained: Iterable[tuple[str, int]]) -> bool:
        """Return whether trainings have reached the bound; for `trained` see `training_flops`."""
        return training_flops(trained, images=self.images, epochs=self.epochs, seeds=self.seeds) >= self.flops


def training_flops(trained: Iterable[tuple[str, int]], *, images: int, epochs: int, seeds: int = 1) -> int:
    """Add up the FLOPs of trainings: forward FLOPs of one image x images x epochs x seeds, each network once.

    The backward pass is not counted: a training takes about three times as many, whatever the network. A network that
    comes again is recalled and not trained again.

    Args:
        trained: what names a network (its source, or the hash of it), and the forward FLOPs that its probe counted for
            one image, >= 0. An elite that is trained again with other seeds has another name each time. Trainings that
            failed are not among them: where they stopped is not known.
        images: of the training split, in every epoch.
        epochs: of every training.
        seeds: trainings of a network.
    """
    return images * epochs * seeds * sum(dict(trained).values())


def trained_networks(lines: Iterable[CandidateLine]) -> list[tuple[str, int]]:
    """Return the networks of a ledger that trained, for `training_flops`, by the hash of their sources."""
    return [(str(line.source), line.flops or 0) for line in lines if line.fitness is not None]
