"""The cache sizes that oneDNN sees: it splits the sums of a convolution by them, so they decide bits.

oneDNN reads them from the CPU and has no setting for them, so they are written where it keeps them: in its object that
describes the CPU, whose place is in the symbol table of torch's library. Nothing is written unless oneDNN's own
function reads its answers from just those words.
"""

import ctypes
import mmap
import struct
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np

from tacevo.errors import SandboxError

#: Set for the processes of a sandbox: bytes of the caches of level 1 to 3 of one core, with commas between.
VARIABLE = "TACEVO_CACHES"

_CPU = b"_ZZN4dnnl4impl3cpu3x643cpuEvE4cpu_"
_SIZE_OF_CACHE = b"_ZN4dnnl4impl3cpu8platform23get_per_core_cache_sizeEi"
#: The torch whose oneDNN this is, and whose bits are recorded (`tacevo.reproduce.bits`).
TORCH = "2.13.0"
#: `Xbyak::util::Cpu` of its oneDNN, in words of 32 bits: how many there are, and where the sizes of its ten caches
#: begin, the numbers of cores that share each, and the number of caches.
_WORDS, _SIZES, _SHARING, _LEVELS = 36, 6, 16, 26

#: The records of ELF: a section's header, and a symbol. A section of the type 2 is a table of symbols; it links to
#: their names.
_SECTION = np.dtype(
    {
        "names": ["type", "offset", "size", "link"],
        "formats": ["<u4", "<u8", "<u8", "<u4"],
        "offsets": [4, 24, 32, 40],
        "itemsize": 64,
    }
)
_SYMBOL = np.dtype(
    [("name", "<u4"), ("info", "u1"), ("other", "u1"), ("section", "<u2"), ("value", "<u8"), ("size", "<u8")]
)
_SYMBOLS = 2


def pin(sizes: Sequence[int]) -> None:
    """Have oneDNN compute as on a CPU whose cores have caches of these sizes: bytes, from level 1 on.

    Does nothing with another version of torch, whose bits are others anyway.

    Raises:
        SandboxError: this build of torch keeps the sizes elsewhere.
    """
    if version("torch").partition("+")[0] != TORCH:
        return
    start, library = _loaded("libtorch_cpu.so")
    symbols = _symbols(library, (_CPU, _SIZE_OF_CACHE))
    if symbols.keys() != {_CPU, _SIZE_OF_CACHE} or symbols[_CPU][1] != 4 * _WORDS:
        raise _unknown(f"the symbols {symbols}")
    size_of_cache = ctypes.CFUNCTYPE(ctypes.c_uint32, ctypes.c_int)(start + symbols[_SIZE_OF_CACHE][0])
    seen = [size_of_cache(level) for level in range(1, len(sizes) + 1)]  # which makes the object, if it was not there
    words = (ctypes.c_uint32 * _WORDS).from_address(start + symbols[_CPU][0])
    held = [
        words[_SIZES + index] // max(words[_SHARING + index], 1) for index in range(min(words[_LEVELS], len(sizes)))
    ]
    if held != seen[: len(held)]:
        raise _unknown(f"{held} where oneDNN reads {seen}")
    for index, size in enumerate(sizes):
        words[_SIZES + index], words[_SHARING + index] = size, 1
    words[_LEVELS] = len(sizes)
    now = [size_of_cache(level) for level in range(1, len(sizes) + 1)]
    if now != list(sizes):
        raise _unknown(f"{now} after writing {list(sizes)}")


def _unknown(got: str) -> SandboxError:
    remedy = "install the torch of torch.lock, or set numerics=fast"
    return SandboxError(got, place=VARIABLE, expected=f"the oneDNN of torch {TORCH}", remedy=remedy)


def _loaded(name: str) -> tuple[int, Path]:
    """Return the address at which a library of this process begins, and its file."""
    with Path("/proc/self/maps").open() as maps:
        for line in maps:
            if line.rstrip().endswith(f"/{name}"):
                return int(line.partition("-")[0], 16), Path(line[line.index("/") :].rstrip())
    raise _unknown(f"no {name} in this process")


def _symbols(library: Path, names: Sequence[bytes]) -> dict[bytes, tuple[int, int]]:
    """Look symbols up in the ELF file of a library; return the address and the size of those that it has."""
    found = {}
    with library.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        [table], [count] = struct.unpack_from("<Q", data, 40), struct.unpack_from("<H", data, 60)
        sections = np.frombuffer(data[table : table + _SECTION.itemsize * count], _SECTION)
        for section in sections[sections["type"] == _SYMBOLS]:
            begin, texts = int(section["offset"]), sections[section["link"]]
            symbols = np.frombuffer(data[begin : begin + int(section["size"])], _SYMBOL)
            first, last = int(texts["offset"]), int(texts["offset"] + texts["size"])
            for name in names:
                offset = data.find(b"\0" + name + b"\0", first, last) + 1 - first
                for symbol in symbols[symbols["name"] == offset] if offset > 0 else ():
                    found[name] = int(symbol["value"]), int(symbol["size"])
    return found
