"""How trained bits depend on the machine, as environment variables for the sandbox; see docs/determinism.md."""

import platform
from importlib.util import find_spec
from pathlib import Path

from tacevo.choices import Device, Numerics
from tacevo.errors import ConfigError

#: One thread: sums would otherwise depend on how many there are, and a zygote with threads cannot fork safely.
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}

#: Each of these libraries would else choose its kernels by the CPU it finds.
_ONE_INSTRUCTION_SET = {
    "ATEN_CPU_CAPABILITY": "avx2",
    "ONEDNN_MAX_CPU_ISA": "AVX2",
    "MKL_CBWR": "COMPATIBLE",
}

#: In bytes: glibc's malloc keeps what is freed below these. Else every step gives its tensors' pages back and has them
#: zeroed anew, which took a tenth of a training's time (the baseline's, at 32 pixels).
_KEPT_MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(1 << 30), "MALLOC_TRIM_THRESHOLD_": str(1 << 30)}

#: Without a workspace of fixed size, cuBLAS may add up in another order each time.
_CUBLAS = {"CUBLAS_WORKSPACE_CONFIG": ":4096:8"}


def environment(numerics: Numerics, device: Device = Device.cpu) -> dict[str, str]:
    """Give the variables that must be set before torch is imported."""
    instructions = _ONE_INSTRUCTION_SET if numerics is Numerics.portable else {}
    return _ONE_THREAD | _KEPT_MEMORY | instructions | (_CUBLAS if device is Device.cuda else {})


def check_machine(numerics: Numerics, device: Device = Device.cpu) -> None:
    """Refuse numerics or a device that this machine cannot compute with.

    Raises:
        ConfigError: portable numerics without an x86-64 with AVX2, or CUDA without a GPU or a torch that knows it.
    """
    table = Path("/proc/cpuinfo")
    refuse_unfit(numerics, platform.machine(), table.read_text(errors="replace") if table.exists() else "")
    if device is Device.cuda:
        torch = find_spec("torch")  # found, not imported: no process but the sandbox's needs it
        library = Path(torch.origin if torch and torch.origin else "").parent / "lib" / "libtorch_cuda.so"
        for needed in (Path("/dev/nvidiactl"), library):
            if not needed.exists():
                raise ConfigError(
                    f"training.device=cuda needs an NVIDIA GPU and a torch built for it; {needed} is not there. "
                    "Set training.device=cpu"
                )


def refuse_unfit(numerics: Numerics, machine: str, cpuinfo: str) -> None:
    """Refuse portable numerics on the machine described.

    Args:
        numerics: what a run asks for.
        machine: as `platform.machine` names the architecture.
        cpuinfo: text of /proc/cpuinfo.

    Raises:
        ConfigError: the machine is no x86-64 with AVX2.
    """
    flags = {flag for line in cpuinfo.splitlines() if line.startswith("flags") for flag in line.split()}
    if numerics is Numerics.portable and not (machine == "x86_64" and "avx2" in flags):
        came = "x86_64 without avx2 in /proc/cpuinfo" if machine == "x86_64" else machine
        raise ConfigError(
            f"numerics=portable needs an x86_64 CPU with avx2; this is {came}. "
            "Set numerics=fast: training bits then hold on this machine only"
        )
