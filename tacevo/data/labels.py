"""Labels as people read them: names, units and values of a finished data set."""

import math

import numpy as np
import numpy.typing as npt

from tacevo.data.dataset import Dataset
from tacevo.parts.source import Catalogue
from tacevo.records import Kind

#: Units that the name of a column may end in, e.g. `depth_mm`; such a name states the unit.
_ENDINGS = ("mm", "um", "deg", "rad", "N", "mN", "Nm", "MPa", "kPa")


def units_of(catalogue: Catalogue) -> tuple[str, ...]:
    """Find the unit of every output: the source's statement, else the ending of its name.

    It is empty where it is unknown: a force may be in N or in mN.
    """
    return tuple(map(_stated, catalogue.names)) if catalogue.units is None else catalogue.units


def _stated(name: str) -> str:
    """Read the unit that a name ends in, `mm` of `depth_mm`."""
    stem, _, ending = name.rpartition("_")
    return ending if stem and ending in _ENDINGS else ""


def plain_name(name: str, unit: str) -> str:
    """Write an output's name without its unit: `shear yaw` for `shear_yaw_deg` in `deg`."""
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


def texts_of(dataset: Dataset, units: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Write every row's label: the class, or a line per output such as `Fx -0.12 N`.

    Values are rounded so that the largest of each output keeps three digits.
    """
    names, labels = dataset.facts.names, labels_of(dataset)
    if dataset.facts.kind is Kind.classification:
        return [(names[int(number)],) for (number,) in labels]
    decimals = [_decimals(column) for column in labels.T]
    return [tuple(map(_text, names, units, row, decimals)) for row in labels]


def in_order(dataset: Dataset, units: tuple[str, ...]) -> npt.NDArray[np.int64]:
    """Sort the rows by label, for looking at.

    By class; by magnitude where all of several outputs have one known unit, as the components of a force do; else by
    the first output. Rows with equal labels stay in their order.
    """
    labels = labels_of(dataset)
    vector = labels.shape[1] > 1 and units[0] != "" and len(set(units)) == 1
    key = np.hypot.reduce(labels, axis=1) if vector else labels[:, 0]
    return np.argsort(key, kind="stable")


def _decimals(values: npt.NDArray[np.float64]) -> int:
    """Decimals at which the largest value has three digits."""
    largest = float(np.abs(values).max())
    return 0 if largest == 0 else max(0, 2 - math.floor(math.log10(largest)))


def _text(name: str, unit: str, value: float, decimals: int) -> str:
    """Write one value with its name and unit; where the unit says it all, as in `17.5 Shore A`, without the name."""
    number = f"{round(value, decimals) + 0.0:.{decimals}f}"  # + 0.0: -0.0 is written 0.0
    if name.lower() in unit.lower().split():
        return f"{number} {unit}"
    return f"{plain_name(name, unit)} {number} {unit}".rstrip()
