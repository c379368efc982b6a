"""Samples as the statistics take them: checked before anything is computed."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Sample = NDArray[np.float64]


def checked(values: ArrayLike, *, name: str) -> Sample:
    """Return a sample as an array, once it is one.

    Args:
        values: one number for each seed, shape (n,), n >= 2.
        name: what a message calls the sample, e.g. `mse of variant 1`.

    Raises:
        ValueError: the shape is another, there are fewer than two values, or one is NaN or infinite; the message
            names the positions, which are the seeds.
    """
    sample = np.asarray(values, dtype=np.float64)
    if sample.ndim != 1 or len(sample) < 2:
        raise ValueError(f"{name} must have shape (n,) with n >= 2 seeds; got shape {sample.shape}")
    broken = np.flatnonzero(~np.isfinite(sample)).tolist()
    if broken:
        raise ValueError(f"{name} is not finite for seeds {broken}; drop or rerun those seeds first")
    return sample
