"""Disks of a test's own: small ones, and ones that cannot be written to; skipped where nobody may mount any."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


@contextmanager
def small_disk(folder: Path, kibibytes: int) -> Iterator[None]:
    """Mount a file system in memory of so many KiB on a directory."""
    _mount("-t", "tmpfs", "-o", f"size={kibibytes}k", "tmpfs", str(folder))
    try:
        yield
    finally:
        _unmount(folder)


def enlarge(folder: Path, kibibytes: int) -> None:
    """Return a small disk another size."""
    _mount("-o", f"remount,size={kibibytes}k", str(folder))


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """Let nobody write below a directory for a while, not even root."""
    _mount("--bind", str(folder), str(folder))
    try:
        _mount("-o", "remount,bind,ro", str(folder))
        yield
    finally:
        _unmount(folder)


def _mount(*arguments: str) -> None:
    if os.geteuid() != 0 or shutil.which("mount") is None:
        pytest.skip("only root mounts disks")
    done = subprocess.run(["mount", *arguments], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        pytest.skip(f"this system mounts no disk for a test: {done.stderr.strip()}")


def _unmount(folder: Path) -> None:
    subprocess.run(["umount", "--lazy", str(folder)], check=True)
