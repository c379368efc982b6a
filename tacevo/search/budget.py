"""What the trainings of a search take, in FLOPs, and the bound on it that ends a search; pure."""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """A bound on the trainings of a search."""

    #: What the search ends at, in FLOPs as `training_flops` counts them; > 0.
    flops: float
    #: Images in one epoch of a training, and epochs.
    images: int
    epochs: int

    def is_spent(self, trained: Iterable[tuple[str, int]]) -> bool:
        """Return whether trainings have reached the bound; for `trained` see `training_flops`."""
        return training_flops(trained, images=self.images, epochs=self.epochs) >= self.flops


def training_flops(trained: Iterable[tuple[str, int]], *, images: int, epochs: int) -> int:
    """Add up the FLOPs of trainings: forward FLOPs of one image x images x epochs, each network once.

    The backward pass is not counted: a training takes about three times as many, whatever the network. A network that
    comes again is recalled and not trained again.

    Args:
        trained: what names a network (its source, or the key of its evaluation), and the forward FLOPs that its probe
            counted for one image, >= 0. Trainings that failed are not among them: where they stopped is not known.
        images: of the training split, in every epoch.
        epochs: of every training.
    """
    return images * epochs * sum(dict(trained).values())
