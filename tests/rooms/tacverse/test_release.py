"""Promise: what a download of the release lacks is named, and a whole one is told as whole."""

from pathlib import Path

import pytest
from small_recordings import save_image

from tacevo.choices import RecordedTask
from tacevo.data.sources.release import ARCHIVES, BYTES, HELD, SIZES, compared

#: A release of so many images and these sensors, as small as its layout lets it be.
SMALL = {
    RecordedTask.force: (2, ("TacTip",)),
    RecordedTask.grating: (30, ("ViTacTip",)),
    RecordedTask.shape: (9, ("TacTip",)),
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole small release."""
    root = tmp_path_factory.mktemp("release")
    names = [f"Force_Regression/TacTip/image_{number}.png" for number in range(2)]
    names += [f"Grating_Classification/ViTacTip/Blackdot/{size:.2f}_1_1.png" for size in SIZES]
    names += [f"Shape_Classification/TacTip/{number}/1.png" for number in range(9)]
    for name in names:
        save_image(root / name, 0)
    (root / "Force_Regression" / "TacTip" / "TacTip.csv").write_text("image_name,fx,fy,fz\n")
    return root


def test_whole_release_is_as_released(whole: Path) -> None:
    """By counts and names of every task."""
    told, differing = compared(whole, SMALL)
    assert differing == ()
    assert len(told) == 3
    assert all("as released" in line for line in told)


@pytest.mark.parametrize(
    ("gone", "words"),
    [
        ("Force_Regression/TacTip/image_1.png", "Force_Regression: 1 images in place of 2"),
        ("Force_Regression/TacTip/TacTip.csv", "TacTip lacks its table"),
        ("Grating_Classification/ViTacTip/Blackdot/1.00_1_1.png", "ViTacTip/Blackdot lacks 1 mm"),
        ("Shape_Classification/TacTip/8", "TacTip has 8 shapes in place of 9"),
        ("Shape_Classification/TacTip", "it lacks TacTip"),
    ],
)
def test_what_is_not_there_is_named(whole: Path, tmp_path: Path, gone: str, words: str) -> None:
    """An image, a table, a size, a shape or a sensor."""
    kept = tmp_path / "kept"
    (whole / gone).rename(kept)
    try:
        told, differing = compared(whole, SMALL)
    finally:
        kept.rename(whole / gone)
    assert len(differing) == 1
    assert words in differing[0]
    assert differing[0] in told


def test_one_task_may_be_there_alone_and_archives_are_measured(tmp_path: Path) -> None:
    """An absent task differs in nothing; an archive that was cut off does."""
    (tmp_path / "shape.zip").write_bytes(b"PK")
    told, differing = compared(tmp_path, SMALL)
    assert len(told) == 4
    assert differing == told[3:]
    assert f"1 archive of 2 bytes, in place of {ARCHIVES} of {BYTES:,} bytes" in told[3]


def test_sensors_of_ones_own_are_compared_with_no_release(tmp_path: Path) -> None:
    """A laboratory may lay its images out so; one sensor of the release beside them, and it is a download again."""
    save_image(tmp_path / "Grating_Classification" / "Mine" / "Plate" / "1_1_1.png", 0)
    told, differing = compared(tmp_path, SMALL)
    assert "Grating_Classification: sensors of your own (Mine)" in told
    assert differing == ()
    save_image(tmp_path / "Grating_Classification" / "ViTacTip" / "Blackdot" / "1_1_1.png", 0)
    assert len(compared(tmp_path, SMALL)[1]) == 1


def test_release_that_was_unpacked_a_level_too_deep_is_a_broken_download(tmp_path: Path) -> None:
    """Its sensors are not the reader's own."""
    deep = tmp_path / "Grating_Classification" / "Grating_Classification"
    save_image(deep / "ViTacTip" / "Blackdot" / "1_1_1.png", 0)
    assert len(compared(tmp_path, SMALL)[1]) == 1


def test_figures_of_the_release_agree_with_its_total() -> None:
    """The authors' page has 106,800 images of three tasks; 30 sizes reach from 0.3 to 1.75 mm."""
    assert sum(images for images, _ in HELD.values()) == 106_800
    assert (SIZES[0], SIZES[-1], len(set(SIZES))) == (0.3, 1.75, 30)
