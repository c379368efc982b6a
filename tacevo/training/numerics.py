"""How trained bits depend on the machine, as environment variables for the sandbox; see docs/determinism.md."""

from tacevo.choices import Numerics

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
