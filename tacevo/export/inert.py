"""Whether a file of a network holds operators and numbers alone; who loads it does so without a sandbox."""

import importlib
import io
import json
import re
import zipfile
from collections.abc import Iterator
from typing import Any

#: The members of what torch.export writes of a program that has plain tensors alone.
_CONFIGS = ("archive/data/weights/model_weights_config.json", "archive/data/constants/model_constants_config.json")

_MEMBER = re.compile(
    "|".join(
        [
            r"archive/data/(weights/weight|constants/tensor)_\d+",
            r"archive/(models/model\.json|data/sample_inputs/model\.pt|archive_format|archive_version|byteorder)",
            r"archive/\.data/(version|serialization_id)",
            *map(re.escape, _CONFIGS),
        ]
    )
)

_PATH = re.compile(r"(weight|tensor)_\d+")

#: Torch unpickles what stands in these.
_EMPTY = frozenset({"archive/data/sample_inputs/model.pt"})


def parts(message: Any) -> Iterator[Any]:
    """Yield a protobuf message and all that it holds: graphs of nodes and functions, too."""
    yield message
    for field, value in message.ListFields():
        if field.message_type is not None:
            for part in [value] if hasattr(value, "ListFields") else value:
                yield from parts(part)


def check_onnx(file: bytes) -> None:
    """Check that an ONNX file names no other file, and has standard operators only, wherever they are nested.

    Raises:
        ValueError: it does or has not, or it is not such a file.
    """
    onnx: Any = importlib.import_module("onnx")  # of the extra
    try:
        model = onnx.ModelProto.FromString(file)
    except Exception as error:  # protobuf's own class, which is not always a ValueError
        raise ValueError(f"expected an ONNX model; got another file: {error}") from error
    domains = {"", "ai.onnx"}
    own = {(function.domain, function.name) for function in model.functions}
    for part in parts(model):
        match type(part).__name__:
            case "StringStringEntryProto":  # where external data lie, and notes
                raise ValueError(f"expected no data of other files and no notes; got {part.value[:100]!r}")
            case "TensorProto" if part.data_location != onnx.TensorProto.DEFAULT:
                raise ValueError(f"expected tensors within the file; got {part.name[:100]!r}")
            case "NodeProto" if part.domain not in domains and (part.domain, part.op_type) not in own:
                raise ValueError(f"expected operators of ONNX; got {part.domain[:100]}.{part.op_type[:100]}")


def check_pt2(file: bytes) -> None:
    """Check that a file of torch.export has only the members of a plain program, and nothing that torch would unpickle.

    Whoever loads the file does so without a sandbox, so what is not known is refused: torch unpickles custom objects,
    weights that say so, and whole archives of an older layout, and loads compiled libraries.

    Raises:
        ValueError: it has something else, or it is not such a file.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(file)) as archive:
            members = {member.filename: member for member in archive.infolist()}
            if len(members) != len(archive.infolist()):
                raise ValueError("expected each member once; got one twice")
            for name, member in members.items():
                stored = member.compress_type == zipfile.ZIP_STORED and member.file_size == member.compress_size
                if not _MEMBER.fullmatch(name) or not stored or (name in _EMPTY and member.file_size):
                    raise ValueError(f"expected the members of a plain program; got {name[:100]!r}")
            for config in _CONFIGS:
                for one in json.loads(archive.read(config))["config"].values():
                    if one["use_pickle"] is not False or not _PATH.fullmatch(one["path_name"]):
                        raise ValueError(f"expected plain weights; got {str(one)[:100]}")
    except (zipfile.BadZipFile, LookupError, TypeError, AttributeError, RuntimeError, EOFError) as error:
        raise ValueError(f"expected the archive of a torch.export; got another: {error}") from error
