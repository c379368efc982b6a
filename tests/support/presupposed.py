"""What the pages presuppose in the directory where a reader stands: a run, a sweep, recordings."""

import re
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from checkout import GOLDEN, LIBRARY, PUBLISHED, ROOT
from commands import tacevo
from PIL import Image
from small_recordings import save_arrays, save_image
from smallest import SIMULATED, UNTRACKED
from supplement import PAGE
from tiny_sweep import SIZES, run_sweep


def write_presupposed(folder: Path) -> None:
    """Record the demo again from its bundle, study it, and write all else; networks have the names that pages use."""
    (folder / "cache").mkdir()
    (folder / "cache" / "published").symlink_to(PUBLISHED)
    (folder / "cache" / "tables").symlink_to(ROOT / "cache" / "tables")
    (folder / "docs").symlink_to(ROOT / "docs")
    (folder / "examples").symlink_to(ROOT / "examples")
    (folder / "grating-claude.zip").symlink_to(PUBLISHED / "grating-claude.zip")
    shutil.copytree(ROOT / "conf", folder / "conf")
    with zipfile.ZipFile(GOLDEN / "demo.zip") as bundle:
        tacevo("cache", "import", bundle.extract("store.jsonl.xz", folder), cwd=folder)
    demo = re.findall(r"^\t\$\(BIN\)/tacevo (.*runs/demo.*)", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
    assert len(demo) == 3
    for line in (*demo, "study runs/demo elites=1 seeds=4 epochs=1"):
        tacevo(*line.split(), cwd=folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        run_sweep(Path("sweeps/tiny"), Path("cache"))
    write_recordings(folder / "IMAGES")
    write_logs(folder / "LOGS")
    save_arrays(folder / "FILE.npz", labels=np.linspace(0, 1, 36).reshape(12, 3))
    write_release(folder / "tacverse")
    recorded = ["data=tacverse", "data.root=tacverse", "run.dir=runs/tacverse"]
    small = [setting for setting in SIMULATED if setting != "data.images=40"]
    tacevo("search", *small, UNTRACKED, *SIZES, *recorded, cwd=folder)
    (folder / "mine").mkdir()
    for name, network in {
        "a.py": "force/baseline.py",
        "b.py": "force/published/variant1.py",
        "FOUND.py": "grating/published/variant1.py",
        "answer.txt": "grating/baseline.py",
        "mine/first.py": "grating/by_hand.py",
    }.items():
        shutil.copy(LIBRARY / network, folder / name)
    (folder / "index.html").write_text(PAGE, encoding="utf-8")


def write_logs(folder: Path) -> None:
    """Write the logs of a robot that touched something 20 times: images, forces and torques."""
    folder.mkdir()
    rng = np.random.default_rng(0)
    for touch in range(20):
        images = rng.integers(0, 256, (5, 24, 32, 3), dtype=np.uint8)
        np.savez(folder / f"touch{touch:02d}.npz", images=images, wrench=rng.normal(size=(5, 6)))


def write_recordings(folder: Path) -> None:
    """Write images in ten classes, and a table of labels beside them."""
    images = np.random.default_rng(0).integers(0, 256, (100, 64, 64, 3), dtype=np.uint8)
    rows = ["image,fx,fy,fz,depth_mm,roll_deg,pitch_deg"]
    for number, image in enumerate(images):
        name = f"{number % 10}/{number}.png"
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(image).save(folder / name)
        rows.append(",".join([name, *(str(number % most) for most in (100, 7, 5, 3, 11, 9))]))
    (folder / "labels.csv").write_text("\n".join(rows))


def write_release(root: Path) -> None:
    """Write a small release of the authors' kind: beside its images, which have sensors A, B and C, too, archives."""
    from tacevo.data.sources import release

    for sensor in ("ViTacTip", "A", "B", "C"):
        folder, rows = root / "Force_Regression" / sensor, ["image_name,fx,fy,fz"]
        for number in range(20):
            save_image(folder / f"image_{number}.png", number)
            rows.append(f"image_{number}.png,{number},{number % 7},{number % 5}")
        (folder / f"{sensor}.csv").write_text("\n".join(rows))
    for number, size in enumerate(release.SIZES * 10):
        place = root / "Grating_Classification" / "ViTacTip" / "Blackdot"
        save_image(place / f"{size:.2f}_{number}_1.png", number % 256)
    for number in range(90):
        save_image(root / "Shape_Classification" / "ViTacTip" / str(number % 9) / f"{number}.png", number)
    for task in [*root.iterdir()]:
        shutil.make_archive(str(task), "zip", root, task.name)
