"""The images for training, for validation and for the test: by a seed, or in the order of a release.

Promises: the three parts are disjoint and complete, and images that were recorded together are never in two.
"""

from fractions import Fraction

import numpy as np
import numpy.typing as npt

from tacevo.errors import DataError
from tacevo.parts.source import Split
from tacevo.randomness import stream

#: The parts of all images that are held out for validation and for the test, where nothing else is asked. Keys of data
#: sets that were made with these do not name them, so they stay, whatever the settings' defaults become.
TENTHS = (0.1, 0.1)


#: The number of times that groups are dealt out which a setting names, for the split that is nearest to the wanted
#: sizes. Groups that a source itself has are dealt out once: their splits are older than this, and stay.
TRIES = 100

#: The fields of `tacevo.parts.source.Split`.
PARTS = ("train", "validation", "test")


def part_sizes(count: int, held_out: tuple[float, float]) -> tuple[int, int, int]:
    """Return how many of so many rows are for training, validation and the test, as `random_split` deals them out.

    They are wanted sizes: the first may be below 1, and groups that are kept together may shift all of them.
    """
    validation, test = (int(Fraction(str(part)) * count + Fraction(1, 2)) for part in held_out)  # as it is written
    return count - validation - test, validation, test


def dealt(
    count: int,
    seed: int,
    *,
    held_out: tuple[float, float],
    groups: npt.NDArray[np.int64] | None,
    chosen_by: str | None,
    classes: npt.NDArray[np.int64] | None,
) -> Split:
    """Split rows at random as `random_split` does; `chosen_by` is the setting that names the groups, if one does.

    Raises:
        DataError: there are too few groups; or as `random_split`.
    """
    if groups is not None and (found := len(np.unique(groups))) < 3:
        expected = "at least 3 groups of images, one for each part of the split"
        remedy = "record more presses, or name smaller groups"
        raise DataError(str(found), place=chosen_by or "the data set", expected=expected, remedy=remedy)
    tries = 1 if chosen_by is None else TRIES
    return random_split(count, seed, held_out=held_out, groups=groups, classes=classes, tries=tries)


def random_split(
    count: int,
    seed: int,
    *,
    held_out: tuple[float, float] = TENTHS,
    groups: npt.NDArray[np.int64] | None = None,
    classes: npt.NDArray[np.int64] | None = None,
    tries: int = 1,
) -> Split:
    """Split rows at random into training, validation and test; no group is ever torn.

    `held_out` says which parts of all rows, in (0, 1), are for validation and for the test. Both are rounded to the
    nearest whole number, so the paper's 3,507 gratings give its 351 test images. Where rows share groups, which are at
    least three, whole groups are dealt out, and the parts end at the group ends nearest to those numbers. Where no two
    rows share one, rows are dealt out alone. Each class is dealt out evenly; a group counts as one of its first
    row's class. Of several tries, which matter to groups of different sizes alone, the first counts that lacks the
    fewest classes in its parts and comes nearest to the numbers. Groups and class numbers are of shape (count,). The
    seed is the split's own, apart from the run's.

    Raises:
        DataError: a part would be empty.
    """
    train, validation, test = part_sizes(count, held_out)
    ends = (train, count - test)
    if min(train, validation, test) < 1:
        raise DataError(
            f"{train}, {validation} and {test} of {count}",
            place="the data set",
            expected="at least one image each for training, validation and test",
            remedy="take more images, or change data.validation_part and data.test_part",
        )
    rng = stream(seed, "split")
    if groups is None or len(np.unique(groups)) == count:
        return _split_at(_spread(rng.permutation(count), classes), ends)
    _, first, members, sizes = np.unique(groups, return_index=True, return_inverse=True, return_counts=True)

    def dealt() -> Split:
        order = _spread(rng.permutation(len(sizes)), None if classes is None else classes[first])
        rank_of_group = np.argsort(order)
        rows = np.argsort(rank_of_group[members], kind="stable")
        return _split_at(rows, _group_ends(np.cumsum(sizes[order]), ends))

    return min((dealt() for _ in range(tries)), key=lambda split: _misfit(split, (train, validation, test), classes))


def _misfit(split: Split, wanted: tuple[int, int, int], classes: npt.NDArray[np.int64] | None) -> tuple[int, int]:
    """Count the classes that parts lack, and the rows that parts have beyond what is wanted or lack to it."""
    parts = (split.train, split.validation, split.test)
    held = 0 if classes is None else sum(len(np.unique(classes[part])) for part in parts)
    return -held, sum(abs(len(part) - size) for part, size in zip(parts, wanted, strict=True))


def _group_ends(sums: npt.NDArray[np.int64], ends: tuple[int, int]) -> tuple[int, int]:
    """Move the ends of the first two parts to the nearest group ends that leave every part a group.

    The sums, of shape (G,), say how many rows the first 1, 2, ... groups have; the ends, how many rows are wanted
    before the end of the first two parts.
    """
    second = min(max(_nearest(sums, ends[1]), 2), len(sums) - 1)
    first = min(_nearest(sums, ends[0]), second - 1)
    return int(sums[first - 1]), int(sums[second - 1])


def _spread(order: npt.NDArray[np.int64], classes: npt.NDArray[np.int64] | None) -> npt.NDArray[np.int64]:
    """Reorder a permutation so that every stretch of it holds each class in proportion."""
    if classes is None:
        return order
    share, turn = np.empty(len(order)), np.empty(len(order), dtype=np.int64)
    for number in np.unique(classes):
        indices = np.flatnonzero(classes[order] == number)
        share[order[indices]] = (np.arange(len(indices)) + 0.5) / len(indices)
        turn[order[indices]] = indices[0]  # classes take turns in one order, so that no stretch lacks one
    return np.lexsort((turn, share))


def _nearest(sums: npt.NDArray[np.int64], target: int) -> int:
    """The number of groups to take so that their rows come nearest to a number; the fewer on a tie."""
    return int(np.argmin(np.abs(sums - target))) + 1


def ordered_split(order: npt.NDArray[np.int64]) -> Split:
    """Split rows in a given order: 60 % for training, then 20 % for validation, the rest for test.

    The boundaries are round(0.6 N) and round(0.8 N).
    """
    return _split_at(order, (round(len(order) * 0.6), round(len(order) * 0.8)))


def _split_at(order: npt.NDArray[np.int64], ends: tuple[int, int]) -> Split:
    """Cut ordered row numbers after the training and the validation part."""
    parts = np.split(order.astype(np.int64), ends)
    train, validation, test = (np.sort(part) for part in parts)  # ascending: a pass reads the file forwards
    return Split(train=train, validation=validation, test=test)


def check_balance(parts: Split, classes: npt.NDArray[np.int64], names: tuple[str, ...]) -> None:
    """Check that each part of a split has images of each class: without, it could be neither learnt nor measured.

    Raises:
        DataError: a class is absent from a part.
    """
    for part in PARTS:
        present = np.bincount(classes[getattr(parts, part)], minlength=len(names))
        absent = [name for name, images in zip(names, present, strict=True) if images == 0]
        if absent:
            raise DataError(
                f"no images of {len(absent)} of {len(names)} classes ({', '.join(absent[:5])})",
                place=f"the {part} split",
                remedy="take more images or groups of them, leave these classes out, or try another split",
            )
