"""Environment variables of the sandbox that decide how results depend on the machine (docs/determinism.md)."""

import platform
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from tacevo.choices import Device, Numerics
from tacevo.environment import gpus
from tacevo.errors import ConfigError

#: One thread: sums depend on the number of threads, and a zygote with threads cannot fork safely.
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
#: Otherwise each of these libraries chooses its kernels by the CPU.
_ONE_INSTRUCTION_SET = {"ATEN_CPU_CAPABILITY": "avx2", "ONEDNN_MAX_CPU_ISA": "AVX2", "MKL_CBWR": "COMPATIBLE"}
#: In bytes: below these glibc's malloc keeps what is freed. Otherwise every step returns its tensors' pages, and the
#: kernel zeroes them again, which took a tenth of a training's time (the baseline's, at 32 pixels).
_KEPT_MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(1 << 30), "MALLOC_TRIM_THRESHOLD_": str(1 << 30)}
#: Without a workspace of fixed size, the order of cuBLAS's sums may change between runs.
_CUBLAS = {"CUBLAS_WORKSPACE_CONFIG": ":4096:8"}


def environment(numerics: Numerics, device: Device = Device.cpu) -> dict[str, str]:
    """Return the variables that must be set before torch is imported."""
    instructions = _ONE_INSTRUCTION_SET if numerics is Numerics.portable else {}
    return _ONE_THREAD | _KEPT_MEMORY | instructions | (_CUBLAS if device is Device.cuda else {})


def check_machine(numerics: Numerics, device: Device = Device.cpu, model: str | None = None) -> None:
    """Check that this machine can compute with these numerics on this device, a GPU of this model.

    Raises:
        ConfigError: portable numerics without an x86-64 CPU with AVX2; or CUDA without such a GPU, or without a torch
            that is built for it.
    """
    table = Path("/proc/cpuinfo")
    check_cpu(numerics, platform.machine(), table.read_text(errors="replace") if table.exists() else "")
    if device is Device.cuda:
        torch = find_spec("torch")  # not imported: only the sandbox needs it
        library = Path(torch.origin if torch and torch.origin else "").parent / "lib" / "libtorch_cuda.so"
        for needed in (Path("/dev/nvidiactl"), library):
            if not needed.exists():
                raise ConfigError(
                    f"cuda, but {needed} does not exist",
                    place="training.device",
                    expected="cpu, or an NVIDIA GPU with a torch built for it",
                    remedy="set training.device=cpu",
                )
        check_gpus(model, gpus())


def check_gpus(model: str | None, models: Sequence[str]) -> None:
    """Compare the model of a run with the GPUs that a machine's driver lists; each training compares it with its own.

    Raises:
        ConfigError: none of them is of that model, nor is it a part (MIG) of one.
    """
    if model is not None and models and not model.startswith(tuple(models)):
        raise ConfigError(model, place="training.gpu", expected=" or ".join(dict.fromkeys(models)))


def check_cpu(numerics: Numerics, machine: str, cpuinfo: str) -> None:
    """Check that a machine, by what `platform.machine` and /proc/cpuinfo say of it, can compute with these numerics.

    Raises:
        ConfigError: portable numerics on a machine that is not an x86-64 CPU with AVX2.
    """
    flags = {flag for line in cpuinfo.splitlines() if line.startswith("flags") for flag in line.split()}
    if numerics is Numerics.portable and not (machine == "x86_64" and "avx2" in flags):
        raise ConfigError(
            "x86_64 without avx2 in /proc/cpuinfo" if machine == "x86_64" else machine,
            place="numerics=portable",
            expected="an x86_64 CPU with avx2",
            remedy="set numerics=fast; results are then reproduced on this machine only",
        )
