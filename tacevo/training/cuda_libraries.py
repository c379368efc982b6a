"""CUDA's libraries, mapped before a fork: a process that starts on a GPU finds them, and starts no driver by it.

Torch itself maps what it is linked with when it is imported. What remains is opened by others at their first use: the
driver's library, and the parts of cuDNN. That takes time in each process, and behind walls no file can be opened.
"""

import contextlib
import ctypes
from collections.abc import Callable
from pathlib import Path

#: The driver's library, by the name under which CUDA's runtime opens it; mapped, it starts no driver.
_DRIVER = "libcuda.so.1"
#: The names of libraries: one of CUDA's runtime is mapped where torch is built for CUDA.
_RUNTIME, _CUDNN = "libcudart", "libcudnn.so"


def to_map(maps: str) -> list[str]:
    """List what is to be mapped besides.

    Args:
        maps: /proc/self/maps of a process that has imported torch.

    Returns:
        Names and paths, as dlopen(3) takes them; none where torch is not built for CUDA.
    """
    mapped = {Path(line.split(maxsplit=5)[5]) for line in maps.splitlines() if len(line.split(maxsplit=5)) == 6}
    if not any(path.name.startswith(_RUNTIME) for path in mapped):
        return []
    folders = sorted({path.parent for path in mapped if path.name.startswith(_CUDNN)})
    parts = [str(part) for folder in folders for part in sorted(folder.glob("libcudnn_*.so*"))]
    return [_DRIVER, *parts]


def map_libraries(maps: Path = Path("/proc/self/maps"), load: Callable[[str], object] = ctypes.CDLL) -> list[str]:
    """Map them, as far as they can be; return which were.

    Some parts need others, which may come later in the list: so there are two rounds. One that cannot be mapped is left
    to its first use, which says why.
    """
    names, done = to_map(maps.read_text(errors="replace")), list[str]()
    for _ in range(2):
        for name in [name for name in names if name not in done]:
            with contextlib.suppress(OSError):
                load(name)
                done.append(name)
    return done
