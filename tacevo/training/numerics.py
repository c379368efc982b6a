"""How trained bits depend on the machine, as environment variables for the sandbox; see docs/determinism.md."""

import platform
from pathlib import Path

from tacevo.choices import Numerics
from tacevo.errors import ConfigError

#: One thread: sums would otherwise depend on how many there are, and a zygote with threads cannot fork safely.
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}

#: Each of these libraries would else choose its kernels by the CPU it finds.
_ONE_INSTRUCTION_SET = {
    "ATEN_CPU_CAPABILITY": "avx2",
    "ONEDNN_MAX_CPU_ISA": "AVX2",
    "MKL_CBWR": "COMPATIBLE",
}


def environment(numerics: Numerics) -> dict[str, str]:
    """Give the variables that must be set before torch is imported."""
    return _ONE_THREAD | _ONE_INSTRUCTION_SET if numerics is Numerics.portable else dict(_ONE_THREAD)


def check_machine(numerics: Numerics) -> None:
    """Refuse portable numerics on a machine that cannot compute them.

    Raises:
        ConfigError: the machine is no x86-64 with AVX2.
    """
    table = Path("/proc/cpuinfo")
    refuse_unfit(numerics, platform.machine(), table.read_text(errors="replace") if table.exists() else "")


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
