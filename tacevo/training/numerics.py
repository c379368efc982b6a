"""Environment variables of the sandbox that decide how results depend on the machine (docs/determinism.md)."""

import platform
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from tacevo.choices import Device, Numerics
from tacevo.environment import gpus
from tacevo.errors import ConfigError
from tacevo.sandbox.caches import VARIABLE

#: One thread: sums depend on the number of threads, and a zygote with threads cannot fork safely.
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
#: Otherwise oneDNN sums by the CPU's caches. One core of many servers has these: 32 KiB, 1 MiB, 2 MiB.
_ONE_CACHE = {VARIABLE: "32768,1048576,2097152"}
#: Otherwise each of these libraries chooses its kernels by the CPU.
_INSTRUCTIONS: Mapping[Numerics, Mapping[str, str]] = {
    Numerics.portable: {"ATEN_CPU_CAPABILITY": "avx2", "ONEDNN_MAX_CPU_ISA": "AVX2"},
    Numerics.portable512: {"ATEN_CPU_CAPABILITY": "avx512", "ONEDNN_MAX_CPU_ISA": "AVX512_CORE"},
}
#: MKL's vector library, from which ATen takes functions such as log10, looks at the second one alone: 0 is the code
#: that AMD's CPUs have, on which everything published was trained. `make bits` shows what follows from it.
_ONE_CODE = {"MKL_CBWR": "COMPATIBLE", "MKL_VML_DEBUG_CPU_TYPE": "0"}
#: The instruction sets that these kernels are compiled for; each library would run them without asking the CPU.
_FLAGS: Mapping[Numerics, Sequence[str]] = {
    Numerics.portable: ["avx2"],
    Numerics.portable512: ["avx2", "fma", "avx512f", "avx512bw", "avx512dq", "avx512vl"],
}
#: The sizes, in bytes, below which glibc's malloc keeps what is freed. Otherwise every step returns its tensors' pages,
#: and the kernel zeroes them again, which took a tenth of a training's time (the baseline's, at 32 pixels). Both are
#: needed: page faults fell from 380,000 to 17,000; with the trim threshold alone they rose to 1,250,000.
_KEPT_MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(1 << 30), "MALLOC_TRIM_THRESHOLD_": str(1 << 30)}
#: The fixed workspace of cuBLAS: without a workspace of fixed size, the order of cuBLAS's sums may change between runs.
_CUBLAS = {"CUBLAS_WORKSPACE_CONFIG": ":4096:8"}
#: The environment in which a process that computes on a CPU finds no GPU. Else an export, in which torch asks for one,
#: starts the driver and, it seems, threads; by NVML torch sees without the driver that none is visible.
_NO_GPU = {"CUDA_VISIBLE_DEVICES": "", "PYTORCH_NVML_BASED_CUDA_CHECK": "1"}


def environment(numerics: Numerics, device: Device = Device.cpu) -> dict[str, str]:
    """Return the variables that must be set before torch is imported."""
    gpu = _CUBLAS if device is Device.cuda else _NO_GPU
    one_cpu = {} if numerics is Numerics.fast else {**_INSTRUCTIONS[numerics], **_ONE_CODE, **_ONE_CACHE}
    return {**_ONE_THREAD, **_KEPT_MEMORY, **one_cpu, **gpu}


def check_machine(numerics: Numerics, device: Device = Device.cpu, model: str | None = None) -> None:
    """Check that this machine can compute with these numerics on this device, a GPU of this model.

    Raises:
        ConfigError: numerics for which its CPU lacks instructions; or CUDA without such a GPU, or without a torch that
            is built for it.
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
        ConfigError: portable numerics on a machine that is not an x86-64 CPU with the instructions that they need.
    """
    needed = _FLAGS.get(numerics, ())
    flags = {flag for line in cpuinfo.splitlines() if line.startswith("flags") for flag in line.split()}
    missing = [flag for flag in needed if flag not in flags]
    if needed and (machine != "x86_64" or missing):
        others = "fast; results are then reproduced on this machine only"
        if numerics is Numerics.portable512:
            others = f"portable for every CPU with avx2, or {others}"
        raise ConfigError(
            f"x86_64 without {', '.join(missing)} in /proc/cpuinfo" if machine == "x86_64" else machine,
            place=f"numerics={numerics}",
            expected=f"an x86_64 CPU with {', '.join(needed)}",
            remedy=f"set numerics={others}; what was recorded is replayed here without --retrain",
        )
