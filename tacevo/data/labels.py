"""Labels as people read them: names, units and values of a finished data set."""

import math

import numpy as np
import numpy.typing as npt

from tacevo.data.dataset import Dataset
from tacevo.records import Kind

#: Units of the outputs that this project itself names (see `tacevo.data.simulator`).
_UNITS = {"Fx": "N", "Fy": "N", "Fz": "N", "shore": "Shore A"}
#: Units that the name of a column may end in, e.g. `depth_mm`.
_ENDINGS = ("mm", "um", "deg", "rad", "N", "mN", "Nm", "MPa", "kPa")


def unit_of(name: str) -> str:
    """Find the unit of an output by its name: `N` for `Fx`, `mm` for `depth_mm`, nothing where it is not known."""
    _, _, ending = name.rpartition("_")
    return ending if ending in _ENDINGS and ending != name else _UNITS.get(name, "")


def plain_name(name: str) -> str:
    """Write an output's name without its unit: `shear yaw` for `shear_yaw_deg`."""
    unit = unit_of(name)
    return name.removesuffix(f"_{unit}").replace("_", " ")


def labels_of(dataset: Dataset) -> npt.NDArray[np.float64]:
    """Undo the scaling of the targets.

    Returns:
        Regression: shape (N, K), in the units of the recording, to the precision of the float32 targets.
        Classification: shape (N, 1), class numbers.
    """
    if dataset.facts.kind is Kind.classification:
        return dataset.targets.astype(np.float64).reshape(-1, 1)
    return np.asarray(dataset.targets * np.array(dataset.scale) + np.array(dataset.offset), dtype=np.float64)


def texts_of(dataset: Dataset) -> list[tuple[str, ...]]:
    """Write every row's label: the class, or a line per output such as `Fx -0.12 N`.

    Values are rounded so that the largest of all outputs with the same unit keeps three digits.
    """
    names, labels = dataset.facts.names, labels_of(dataset)
    if dataset.facts.kind is Kind.classification:
        return [(names[int(number)],) for (number,) in labels]
    units = np.array([unit_of(name) for name in names])
    decimals = [_decimals(labels[:, units == unit]) for unit in units]
    return [tuple(map(_text, names, row, decimals)) for row in labels]


def in_order(dataset: Dataset) -> npt.NDArray[np.int64]:
    """Sort the rows by label, for looking at.

    By class; by magnitude where several outputs share a unit, as the components of a force do; else by the first
    output. Rows with equal labels stay in their order.
    """
    labels = labels_of(dataset)
    units = {unit_of(name) for name in dataset.facts.names}
    vector = dataset.facts.kind is Kind.regression and labels.shape[1] > 1 and len(units) == 1 and units != {""}
    key = np.hypot.reduce(labels, axis=1) if vector else labels[:, 0]
    return np.argsort(key, kind="stable")


def _decimals(values: npt.NDArray[np.float64]) -> int:
    """Decimals at which the largest value has three digits."""
    largest = float(np.abs(values).max())
    return 0 if largest == 0 else max(0, 2 - math.floor(math.log10(largest)))


def _text(name: str, value: float, decimals: int) -> str:
    """Write one value with its name and unit; where the unit says it all, as in `17.5 Shore A`, without the name."""
    number, unit = f"{round(value, decimals) + 0.0:.{decimals}f}", unit_of(name)  # + 0.0: -0.0 is written 0.0
    if name.lower() in unit.lower().split():
        return f"{number} {unit}"
    return f"{plain_name(name)} {number} {unit}".rstrip()
