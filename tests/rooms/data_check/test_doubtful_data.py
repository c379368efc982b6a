"""Promise: what is probably wrong with data is said by `tacevo data check`, and before a search, which goes on."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from checkout import SHARED
from PIL import Image
from smallest import ARCHIVES, UNTRACKED

from tacevo.cli.app import main

CASES = SHARED / "cases" / "data"

needs_cases = pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not beside this checkout")


@pytest.fixture(autouse=True)
def _elsewhere(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in a directory of the test's own, and draw two images on a sheet, which takes a tenth of the time of 40."""
    monkeypatch.setattr("tacevo.data.pictures.SHEET_IMAGES", 2)


def save(images: Iterable[np.typing.NDArray[Any]], names: str = "fx,fy,fz") -> list[str]:
    """Write images and a table of three labels each; return the overrides that read them."""
    rng = np.random.default_rng(0)
    root = Path("recording")
    root.mkdir()
    lines = []
    for number, image in enumerate(images):
        Image.fromarray(image).save(root / f"{number:02d}.png")
        lines.append(f"{number:02d}.png,{','.join(f'{value:.3f}' for value in rng.normal(size=3))}\n")
    (root / "labels.csv").write_text(f"image,{names}\n{''.join(lines)}")
    return ["data=csv", "data.root=recording", f"data.target_columns=[{names}]", "data.image_size=16"]


def noise(most: int, kind: type = np.uint16, count: int = 20) -> list[np.typing.NDArray[Any]]:
    """Make images whose values are spread from 0 to the largest."""
    rng = np.random.default_rng(1)
    images: list[np.typing.NDArray[Any]] = [rng.integers(0, most + 1, (16, 16)).astype(kind) for _ in range(count)]
    images[7][3, 3] = most
    return images


def checked(overrides: list[str], capsys: pytest.CaptureFixture[str], status: int = 0) -> dict[str, Any]:
    """Check a data set; return what is found."""
    assert main(["data", "check", *overrides, "--json"]) == status
    told: dict[str, Any] = json.loads(capsys.readouterr().out)
    return told


@pytest.mark.few(1)
@needs_cases
@pytest.mark.parametrize(("case", "most"), [("gray12in16", 4095), ("gray8in16", 255)])
def test_cameras_of_users_are_told(case: str, most: int, capsys: pytest.CaptureFixture[str]) -> None:
    """Twelve and eight bits in files of sixteen."""
    columns = "data.target_columns=[fx,fy,fz]"
    told = checked(["data=csv", f"data.root={CASES / case}", columns, "data.image_size=24"], capsys)
    assert f"is {most} of 65535" in told["warnings"][0]
    assert f"data.white_point={most}" in told["warnings"][0]


@pytest.mark.slow
def test_search_warns_and_goes_on(capsys: pytest.CaptureFixture[str]) -> None:
    """Also where the images were made by a check, and of what the prompt tells the model."""
    overrides = save(noise(4095), "depth_mm,roll_deg,pitch_deg")
    told = checked(overrides, capsys)["warnings"]
    assert len(told) == 2
    small = ["experiment=published_force", *ARCHIVES, UNTRACKED, "training.epochs=1", "search.generations=0"]
    assert main(["search", *small, "search.initial=1", *overrides]) == 0
    said = capsys.readouterr().err
    assert all(f"warning: {words}\n" in said for words in told)
    assert main(["search", *small, "search.initial=1", "experiment=published_force", "data.images=40"]) == 0
    assert "warning: " not in capsys.readouterr().err


@pytest.mark.room("grammar")
def test_what_is_passed_over_or_lies_elsewhere_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    """By a check, once each; the search says the same. Without them both are silent."""
    overrides = save(noise(255, np.uint8))
    assert checked(overrides, capsys)["warnings"] == []
    table = Path("recording/labels.csv")
    table.write_text(f"sep=,\n{table.read_text()},,,\n")
    Path("elsewhere.png").write_bytes(Path("recording/07.png").read_bytes())
    Path("recording/07.png").unlink()
    Path("recording/07.png").symlink_to(Path("elsewhere.png").absolute())
    told = checked(overrides, capsys)
    assert told["images"]["all"] == 20
    assert len(told["warnings"]) == 2
    assert "1 empty row of the table, line 23" in told["warnings"][0]
    assert "outside recording, where links lead: 1 image, line 10 '07.png'" in told["warnings"][1]
    small = ["experiment=published_force", *ARCHIVES, UNTRACKED, "training.epochs=1", "search.generations=0"]
    assert main(["search", *small, "search.initial=1", *overrides]) == 0
    said = capsys.readouterr().err
    assert [said.count(f"warning: {words}\n") for words in told["warnings"]] == [1, 1]


@pytest.mark.slow
def test_check_says_what_the_prompt_tells_the_model(capsys: pytest.CaptureFixture[str]) -> None:
    """The names are those of the data, and what they are said to be is the task's; a mismatch is a warning."""
    overrides = save(noise(65535), "depth_mm,roll_deg,pitch_deg")
    told = checked(overrides, capsys)
    assert "estimates the contact force: 3 values (depth_mm, roll_deg, pitch_deg)" in told["prompt"]
    (warning,) = told["warnings"]
    assert "task=force is for Fx, Fy, Fz, and the data set has depth_mm, roll_deg, pitch_deg" in warning
    assert f'"{told["prompt"]}"' in warning
    lines = Path("recording/labels.csv").read_text().split("\n", 1)
    Path("recording/labels.csv").write_text(f"image,FX,fy_N,fz_mN\n{lines[1]}")
    fitting = [*overrides[:2], "data.target_columns=[FX,fy_N,fz_mN]", overrides[3]]
    assert checked(fitting, capsys)["warnings"] == []
    assert checked(["task=grating", "data.images=70", "data.image_size=16"], capsys)["warnings"] == []


def test_classes_that_are_no_gratings_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    """The prompt speaks of plates with grooves; classes that are sizes suit it."""
    for names, count in ((("wood", "steel"), 1), (("2 mm", "0.5"), 0)):
        for number, image in enumerate(noise(255, np.uint8, 40)):
            path = Path(names[0]) / names[number % 2] / f"{number}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(image).save(path)
        overrides = ["task=grating", "task.outputs=2", "data=folder", f"data.root={names[0]}", "data.image_size=16"]
        warnings = checked(overrides, capsys)["warnings"]
        assert [words for words in warnings if "task=grating is for gratings" in words] == warnings
        assert len(warnings) == count


@pytest.mark.slow
def test_groups_are_told_and_frames_in_two_parts_are_warned_of(capsys: pytest.CaptureFixture[str]) -> None:
    """Four frames of each press: torn without groups, and whole with them."""
    rng = np.random.default_rng(2)
    frames = [
        image + rng.integers(0, 3, (16, 16)).astype(np.uint8) for image in noise(250, np.uint8, 10) for _ in range(4)
    ]
    overrides = save(frames)
    told = checked(overrides, capsys)
    assert told["groups"] is None
    (warning,) = told["warnings"]
    near = told["nearly_equal"]
    assert f"{len(near)} images for validation or test nearly equal one of another part" in warning
    assert "data.group_column=COLUMN" in warning
    for one, other in near:
        assert one["row"] // 4 == other["row"] // 4
        assert one["part"] != other["part"]
        assert one["file"].endswith(f"{one['row']:02d}.png")
    lines = Path("recording/labels.csv").read_text().splitlines()
    grouped = [f"{line},{'press' if number == 0 else (number - 1) // 4}" for number, line in enumerate(lines)]
    Path("recording/labels.csv").write_text("\n".join(grouped))
    known = checked([*overrides, "data.group_column=press"], capsys)
    assert known["groups"] == [4] * 10
    assert (known["nearly_equal"], known["warnings"]) == ([], [])
    assert main(["data", "check", *overrides]) == 0
    out = capsys.readouterr().out
    assert warning in out
    assert [image["file"] for image in near[0] if image["file"] not in out] == []
    assert main(["data", "check", *overrides, "data.group_column=press"]) == 0
    grouped_out = capsys.readouterr().out
    assert warning not in grouped_out
    assert "data.group_column" in grouped_out


@pytest.mark.slow
def test_size_that_no_experiment_was_asked_for_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    """A search of an experiment may take another; with the same experiment it takes the same."""
    overrides = save(noise(255, np.uint8))
    for more, words in (
        (["data.image_size=24"], "used at 24x24 pixels\n"),
        (["experiment=published_force"], "used at 32x32 pixels\n"),
        ([], "used at 256x256 pixels (data.image_size; an experiment may set another"),
    ):
        assert main(["data", "check", *overrides[:3], *more]) == 0
        assert words in capsys.readouterr().out
