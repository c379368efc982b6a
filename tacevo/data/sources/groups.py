"""Which images were recorded together, as a user's setting says."""

import re
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from tacevo.data.source import check_no_faults, shortened


def numbered(shared: Sequence[str]) -> npt.NDArray[np.int64]:
    """Number what the images of a press share: int64, equal where the texts are."""
    return np.unique(np.array(shared, dtype=object), return_inverse=True)[1].astype(np.int64)


def groups_in(paths: Sequence[str], pattern: str) -> npt.NDArray[np.int64]:
    """Find the groups of images by a regular expression on their paths.

    The parts in brackets that it finds are what the images of a group share; without brackets, all that it finds.

    Returns:
        int64, shape (N,): equal for images of one group.

    Raises:
        DataError: a path does not hold the expression.
    """
    found = [re.search(pattern, path) for path in paths]
    check_no_faults(
        f"paths do not hold the regular expression {pattern!r}",
        [shortened(path) for path, match in zip(paths, found, strict=True) if match is None],
        "write one that finds in each path what the images of one press share",
        place="data.group_pattern",
    )
    shared = [repr(match.groups() or match[0]) for match in found if match is not None]
    return numbered(shared)
