"""Pictures for people: the right samples in the right order, equal bytes for equal data, no half-written file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from greys import Greys, grey
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from refusals import refused
from small_recordings import loaded

from tacevo.data.labels import in_order, labels_of, plain_name, texts_of, units_of
from tacevo.data.pictures import SHEET_IMAGES, WIDTHS, contact_sheet, sample_figure, save
from tacevo.data.splitting import PARTS
from tacevo.data.survey import constant_images, equal_images, label_table
from tacevo.errors import ConfigError
from tacevo.records import Kind

FORCES_UNITS, NO_UNITS = ("N", "N"), ("",) * 4
FORCES = Greys(
    labels=tuple((0.03 * number, -0.1 * number) for number in range(40, 0, -1)),
    names=("Fx", "Fz"),
    units=FORCES_UNITS,
    size=16,
)
LEVELS = replace(
    FORCES, labels=tuple((17.5 + 2.5 * (number % 3),) for number in range(60)), names=("shore",), units=None
)
CLASSES = Greys(count=200, names=("a", "b", "c", "d"), kind=Kind.classification)


def shown(figure: Figure) -> list[int]:
    """List the grey values of a figure's pictures, in the order in which they were drawn."""
    images = [image for axes in figure.axes for image in axes.images]
    return [int(np.asarray(image.get_array())[1, 1, 0]) for image in images]


def written(figure: Figure) -> list[str]:
    """List the lines below a figure's pictures."""
    return [line for axes in figure.axes for line in axes.get_xlabel().splitlines()]


@pytest.mark.parametrize(
    ("name", "unit", "plain"),
    [("shear_yaw_deg", "deg", "shear yaw"), ("Fz_mN", "mN", "Fz"), ("Fx", "", "Fx"), ("N", "", "N"), ("_N", "", " N")],
)
def test_units_are_those_that_a_name_ends_in(name: str, unit: str, plain: str) -> None:
    """A force may be in mN: where neither the source nor the column states a unit, it is unknown."""
    labels = ((1.0,),)
    assert units_of(Greys(labels=labels, names=(name,)).catalogue()) == (unit,)
    assert units_of(Greys(labels=labels, names=(name,), units=("m",)).catalogue()) == ("m",)
    assert plain_name(name, unit) == plain


def test_forces_of_an_unknown_unit_are_written_without_one(tmp_path: Path) -> None:
    """Neither the text nor the order supposes that they share a unit, and each output has its own decimals."""
    labels = tuple((0.001 * number, 300.0 - 10 * number) for number in range(20))
    source = Greys(labels=labels, names=("Fx", "Fz"))
    dataset, units = loaded(source, tmp_path), units_of(source.catalogue())
    assert texts_of(dataset, units)[1] == ("Fx 0.0010", "Fz 290")
    assert in_order(dataset, units).tolist() == list(range(20))


def test_only_outputs_of_one_unit_are_ordered_by_magnitude(tmp_path: Path) -> None:
    """Components of a force count together, the least first; millimetres and degrees have no common magnitude."""
    dataset = loaded(FORCES, tmp_path)
    assert in_order(dataset, FORCES_UNITS).tolist() == list(range(39, -1, -1))
    labels = tuple((float(number), 100.0 * (20 - number)) for number in range(20))
    dataset = loaded(Greys(labels=labels, names=("depth_mm", "roll_deg")), tmp_path)
    assert in_order(dataset, ("mm", "deg")).tolist() == list(range(20))


def test_labels_come_back_in_their_units(tmp_path: Path) -> None:
    """The scaling of the targets is undone, and outputs of one unit have equal decimals."""
    dataset = loaded(FORCES, tmp_path)
    assert labels_of(dataset) == pytest.approx(np.array(FORCES.labels), abs=1e-5)
    assert texts_of(dataset, FORCES_UNITS)[0] == ("Fx 1.20 N", "Fz -4.00 N")


def test_zero_has_no_sign(tmp_path: Path) -> None:
    """A value that rounds to zero from below is written as zero."""
    labels = tuple((-1e-9 if number == 0 else float(number),) for number in range(20))
    assert texts_of(loaded(Greys(labels=labels, names=("Fx",)), tmp_path), ("N",))[0] == ("Fx 0.0 N",)


def test_sample_figure_shows_one_of_each_level_or_class(tmp_path: Path) -> None:
    """In the order of the outputs, from the training split."""
    dataset = loaded(LEVELS, tmp_path)
    figure = sample_figure(dataset, units=("Shore A",), width="single")
    assert written(figure) == ["17.5 Shore A", "20.0 Shore A", "22.5 Shore A"]
    assert set(shown(figure)) <= set(dataset.train.tolist())
    assert written(sample_figure(loaded(CLASSES, tmp_path), units=NO_UNITS, width="double")) == ["a", "b", "c", "d"]


def test_sample_figure_goes_from_the_least_to_the_most(tmp_path: Path) -> None:
    """The training split's extremes are the first and the last sample."""
    dataset = loaded(FORCES, tmp_path)
    values = shown(sample_figure(dataset, units=FORCES_UNITS, width="double"))
    assert (values[0], values[-1]) == (dataset.train.max(), dataset.train.min())
    assert values == sorted(values, reverse=True)


@pytest.mark.parametrize("width", WIDTHS)
def test_figure_has_the_width_of_its_columns(width: str, tmp_path: Path) -> None:
    """A paper's column is filled, and no picture or text leaves it."""
    figure = sample_figure(loaded(FORCES, tmp_path), units=FORCES_UNITS, width=width)
    assert figure.get_size_inches()[0] == WIDTHS[width]
    figure.draw_without_rendering()
    for axes in figure.axes:
        box = axes.get_tightbbox()
        assert box is not None
        assert min(box.x0, box.y0) >= 0
        assert box.x1 <= figure.bbox.x1
        assert box.y1 <= figure.bbox.y1


def test_contact_sheet_names_split_and_row_of_so_many(tmp_path: Path) -> None:
    """Every picture can be found again, all splits are shown, and however many images there are, it stays a sheet."""
    dataset = loaded(FORCES, tmp_path)
    figure = contact_sheet(dataset, units=FORCES_UNITS, title="sheet")
    texts = written(figure)
    assert figure.get_suptitle() == "sheet"
    assert {f"train {row}" for row in dataset.train} <= set(texts)
    assert {f"test {row}" for row in dataset.test} <= set(texts)
    assert len(shown(contact_sheet(loaded(CLASSES, tmp_path), units=NO_UNITS, title="sheet"))) == SHEET_IMAGES


@pytest.mark.few(1)
@pytest.mark.parametrize("ending", ["png", "pdf", "svg"])
def test_equal_data_give_equal_bytes(ending: str, tmp_path: Path) -> None:
    """No date and no random identifier is in the file; other data give another one."""
    dataset = loaded(LEVELS, tmp_path / "cache")
    for name, width in (("first", "single"), ("second", "single"), ("other", "double")):
        save(sample_figure(dataset, units=("Shore A",), width=width), tmp_path / f"{name}.{ending}")
    first, second, other = ((tmp_path / f"{name}.{ending}").read_bytes() for name in ("first", "second", "other"))
    assert first == second
    assert first != other


def test_unknown_format_is_refused(tmp_path: Path) -> None:
    """The message lists the endings that are known."""
    with refused(ConfigError, place="-o", expected=".png, .pdf, .svg", got="a.bmp"):
        save(Figure(), tmp_path / "a.bmp")


def test_failed_save_leaves_the_old_picture_alone(tmp_path: Path) -> None:
    """A figure that cannot be drawn leaves neither a part nor a changed file."""
    path = tmp_path / "a.png"
    path.write_text("old")
    broken = Figure()
    broken.text(0, 0, r"$\nonsense$")
    with pytest.raises(ValueError, match="nonsense"):
        save(broken, path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_ranges_of_each_split_are_told(tmp_path: Path) -> None:
    """Minimum, maximum, mean and deviation are those of the labels."""
    dataset = loaded(FORCES, tmp_path)
    table = label_table(dataset, FORCES_UNITS).set_index(["output", "part"])
    for part in PARTS:
        column = np.array(FORCES.labels)[getattr(dataset, part), 1]
        expected = [column.min(), column.max(), column.mean(), column.std()]
        assert table.loc[("Fz [N]", part)].tolist() == pytest.approx(expected, abs=1e-5)


def test_classes_of_each_split_are_counted(tmp_path: Path) -> None:
    """The counts of all splits add up to the classes."""
    table = label_table(loaded(CLASSES, tmp_path), NO_UNITS).set_index("class")
    assert table.sum(axis=1).tolist() == [50, 50, 50, 50]


@given(st.lists(st.integers(0, 5), min_size=1, max_size=20))
def test_equal_images_are_listed_wherever_they_stand(greys: list[int]) -> None:
    """In the order of the rows, and no other image."""
    images = np.array([grey(value, 4) for value in greys])
    rows = [tuple(row for row, one in enumerate(greys) if one == value) for value in dict.fromkeys(greys)]
    assert equal_images(images) == tuple(equal for equal in rows if len(equal) > 1)


def test_constant_images_are_listed() -> None:
    """A picture of one colour; one other pixel is enough not to be."""
    images = np.array([grey(value, 4) for value in range(3)])
    images[1] = np.array([1, 2, 3], dtype=np.uint8)[:, None, None]
    images[2, 1, 3, 3] = 9
    assert constant_images(images) == (0, 1)
