"""Promise: behind the walls of a GPU a driver keeps its device files and its threads, and a candidate gets no more.

There is no GPU here: files of a directory stand for /dev/nvidia*, and a thread for those of CUDA. What the real driver
needs is not known from these tests.
"""

import os
import socket
from pathlib import Path
from typing import Any

import pytest

from tacevo.choices import Confinement
from tacevo.records import Limits
from tacevo.sandbox.client import Finished, Sandbox
from tacevo.sandbox.confinement import available, in_force, report
from tacevo.sandbox.devices import DEVICES, present

pytestmark = [
    pytest.mark.timeout(60),
    pytest.mark.skipif(available() is not Confinement.kernel, reason="the kernel has no Landlock or no seccomp"),
]

LIMITS = Limits(seconds=20, memory_mib=300)

#: What works behind the walls with a device that is a plain file, which knows no command.
DOORS = {
    "open the device": "worked",
    "open another": "worked",
    "map it": "worked",
    "command": "ENOTTY",
    "event": "worked",
    "thread": "worked",
    "open the device, driver's thread": "worked",
    "library, driver's thread": "worked",
}
REFUSED = {"EPERM", "EACCES"}


def tried(folder: Path, doors: list[str], **settings: Any) -> tuple[dict[str, str], tuple[str, ...]]:
    """Try what the driver and what a candidate does; return the outcomes, and the measures that held."""
    dev = folder / "dev"
    dev.mkdir()
    for name in ("nvidiactl", "nvidia0"):
        (dev / name).write_bytes(bytes(2 * 4096))
    outside = folder / "outside"
    outside.write_text("a secret")
    told: list[tuple[str, ...]] = []
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        Sandbox(
            entries={"use": "driver:use"},
            environment={"OMP_NUM_THREADS": "1"},
            arrays={},
            equip="driver:equip",
            doors={"use": doors},
            notice=told.append,
            **settings,
        ) as sandbox,
    ):
        header: Any = {"device": str(dev / "nvidiactl"), "other": str(dev / "nvidia0"), "outside": str(outside)}
        answer = sandbox.run("use", {**header, "search": os.getpid(), "port": server.getsockname()[1]}, b"", LIMITS)
    assert isinstance(answer, Finished), answer
    ((frame,), (measures,)) = answer.frames, told
    assert isinstance(frame.header, dict)
    assert outside.read_text() == "a secret"
    assert sorted(path.name for path in dev.iterdir()) == ["nvidia0", "nvidiactl"]
    return {str(name): str(outcome) for name, outcome in frame.header.items()}, measures


def test_driver_keeps_its_files_and_nothing_else_is_left(tmp_path: Path) -> None:
    """Exactly the device files open, in every thread; the rest is refused by the kernel, and what held is told."""
    outcomes, measures = tried(tmp_path, [str(tmp_path / "dev" / "nvidia*")])
    assert {name: outcomes.pop(name) for name in DOORS} == DOORS
    assert set(outcomes.values()) <= REFUSED
    assert "write before" in outcomes  # the walls stood when the driver started
    described = in_force(measures)
    assert described["level"] == Confinement.kernel
    assert "device files of the GPU" in described["gpu"]
    assert described["seccomp"] != report()["seccomp"]


def test_doors_are_those_of_computing(tmp_path: Path) -> None:
    """Of NVIDIA's device files not those of displays, debuggers and profilers, nor one that only begins alike."""
    names = ("nvidiactl", "nvidia-uvm", "nvidia0", "nvidia11", "nvidia-modeset", "nvidia-uvm-tools", "nvidia", "null")
    (tmp_path / "nvidia-caps").mkdir()
    for name in (*names, "nvidia-caps/nvidia-cap1"):
        (tmp_path / name).touch()
    found = present(pattern.replace("/dev", str(tmp_path), 1) for pattern in DEVICES)
    expected = {"nvidiactl", "nvidia-uvm", "nvidia0", "nvidia11", "nvidia-cap1"}
    assert {Path(path).name for path in found} == expected


def test_file_that_is_not_named_is_no_door(tmp_path: Path) -> None:
    """A device that the patterns do not name cannot be opened by anything that starts behind the walls."""
    outcomes, _ = tried(tmp_path, [str(tmp_path / "dev" / "nvidiactl")])
    assert outcomes["open the device"] == "worked"
    assert outcomes["open another"] in REFUSED


def test_job_that_needs_no_device_has_the_walls_of_a_cpu(tmp_path: Path) -> None:
    """A probe beside trainings on a GPU opens nothing, and starts no thread."""
    told: list[tuple[str, ...]] = []
    (tmp_path / "nvidiactl").touch()
    doors = {"use": [str(tmp_path / "nvidia*")]}
    with Sandbox(
        entries={"look": "wall_attacks:attempt_processes", "use": "driver:use"},
        environment={"OMP_NUM_THREADS": "1"},
        arrays={},
        doors=doors,
        notice=told.append,
    ) as sandbox:
        answer = sandbox.run("look", {"search": os.getpid()}, b"", LIMITS)
    assert isinstance(answer, Finished), answer
    assert isinstance(answer.frames[0].header, dict)
    assert answer.frames[0].header["thread"] == "EAGAIN"
    assert in_force(told[0]) == {**report(), "level": Confinement.kernel}


def test_without_walls_a_candidate_reaches_what_they_keep_from_it(tmp_path: Path) -> None:
    """So the attempts are real: this is what `sandbox.require=none` leaves open on a GPU."""
    dev, outside = tmp_path / "dev", tmp_path / "outside"
    dev.mkdir()
    (dev / "nvidiactl").write_bytes(bytes(4096))
    outside.touch()
    with (
        Sandbox(
            entries={"use": "driver:use"},
            environment={"OMP_NUM_THREADS": "1"},
            arrays={},
            equip="driver:equip",
            strongest=Confinement.none,
        ) as sandbox,
        socket.create_server(("127.0.0.1", 0)) as server,
    ):
        header: Any = {"device": str(dev / "nvidiactl"), "other": str(dev / "nvidiactl"), "outside": str(outside)}
        answer = sandbox.run("use", {**header, "search": os.getpid(), "port": server.getsockname()[1]}, b"", LIMITS)
    assert isinstance(answer, Finished), answer
    assert isinstance(answer.frames[0].header, dict)
    reached = {name for name, outcome in answer.frames[0].header.items() if outcome == "worked"}
    assert reached >= {"read", "write", "make", "list", "library", "network", "program", "write before"}
