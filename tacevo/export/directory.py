"""A candidate exported: trained again, converted, checked, and written as a directory in one step.

What it promises: this process never runs the class; the directory is whole or absent; no weight is pickled.
"""

import keyword
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from tacevo.data.staging import new_directory
from tacevo.environment import install
from tacevo.errors import ConfigError, RunError
from tacevo.evolution.lines import CandidateLine
from tacevo.export.card import card
from tacevo.export.contents import PACKAGES, Exported, config_of, latency_of, run_of
from tacevo.export.conversion import ENTRIES, EQUIP, Networks, check_class, convert
from tacevo.export.trainings import ExportSettings, design, train
from tacevo.gate.imports import with_imports
from tacevo.results.run import RecordedRun
from tacevo.runs.datasets import load_same, source_of
from tacevo.runs.progress import Progress
from tacevo.runs.wiring import check_means
from tacevo.sandbox.client import RunJob, Sandbox
from tacevo.sandbox.protocol import CHILD
from tacevo.storage.canonical import readable
from tacevo.text import listed
from tacevo.training.numerics import environment
from tacevo.training.weights import Weights

#: The key under which safetensors keeps notes.
_METADATA = "__metadata__"

#: Bytes of all weights of an ensemble.
LARGEST = 512 * 2**20

#: Bytes that may come beside the weights: operators, constants that were computed, and predictions.
_BESIDE = 64 * 2**20


def export(
    run: RecordedRun,
    line: CandidateLine,
    target: Path,
    settings: ExportSettings,
    *,
    bundle: str | None,
    retrained: bool,
    view: Progress,
    root: str | None = None,
) -> Exported:
    """Train a candidate again and write it as a directory; return what it says.

    The run is finished, and the candidate was admitted. `bundle` is the digest of the bundle that the run lies in; None
    of a directory. With `retrained`, a training that is not recorded, or goes otherwise, is an error. `root` is where
    the data set of the run lies, if not where the run had it.

    Raises:
        ConfigError: the target exists; or packages of the extra are missing; or this machine cannot train so.
        DataError: the data set is missing, or is another one.
        DivergenceError: with `retrained`, a training is not as recorded; or a study of it does not follow from the
            stores and the data.
        RunError: with `retrained`, one is not recorded; or the source was edited, the network is too large, does not
            train to the end, or says something else with its weights alone. What ONNX cannot hold is no error.
        SandboxError: the sandbox is broken.
    """
    _check_packages()
    _check_absent(target)
    _check_size(line, settings.seeds)
    _check_class(run)
    source = run.directory.read_source(line.id, str(line.source))
    _make_parent(target)
    here = run.with_data if root is None else replace(run.config, data=replace(run.config.data, root=root))
    catalogue = source_of(here).catalogue()
    data = load_same(here, run.record.data, view, catalogue=catalogue)
    plan = design(run, line, settings, data)
    check_means(plan.config)
    trained, doubts = train(run, plan, source, data, view, retrained=retrained)
    model = Exported(
        run=run,
        line=line,
        plan=plan,
        data=data,
        catalogue=catalogue,
        trained=trained,
        doubts=doubts,
        settings=settings,
        bundle=bundle,
    )
    with Sandbox(
        entries=ENTRIES,
        environment=environment(model.numerics),
        arrays={"images": data.images},
        equip=EQUIP,
        answer_bytes=_BESIDE + sum(value.nbytes for one in model.weights for value in one.values()),
    ) as sandbox:
        model = _checked(sandbox.run, model, source, view)
    _write(target, _contents(model, with_imports(source)))
    return model


def _checked(run: RunJob, model: Exported, source: str, view: Progress) -> Exported:
    """Try the class with its weights, and the ONNX file if there can be one; return what was found."""
    networks = Networks(
        source=source, contract=model.contract, data=model.data, weights=model.weights, expected=model.outputs
    )
    images = f"{len(model.data.test)} test images"
    view.say(f"model.py with its weights: checking {images}")
    model = replace(model, built=check_class(run, networks))
    view.say(f"model.onnx: writing it, and checking {images}")
    try:
        return replace(model, onnx=convert(run, networks))
    except RunError as error:  # the class with its weights is there all the same
        why = f"expected {error.expected}; got {error.got}"
        view.say(f"no model.onnx: {why}")
        return replace(model, without_onnx=why)


def _contents(model: Exported, source: str) -> dict[str, bytes]:
    """Return all files by name."""
    texts = {
        "model.py": source,
        "config.json": readable(config_of(model)),
        "run.json": readable(run_of(model)),
        "README.md": card(model),
    }
    weights = {name: _as_safetensors(one) for name, one in zip(model.weight_files, model.weights, strict=True)}
    if model.onnx is not None:
        texts["latency.json"] = readable(latency_of(model, model.onnx))
        weights["model.onnx"] = model.onnx.file
    return {name: text.encode() for name, text in texts.items()} | weights


def _as_safetensors(weights: Weights) -> bytes:
    """Write weights: names, types, shapes and numbers, and no metadata.

    Raises:
        RunError: one has the name that the format has for metadata.
    """
    if _METADATA in weights:
        raise RunError(_METADATA, place="weights", expected="other names of weights", remedy="choose another network")
    written: bytes = import_module("safetensors.numpy").save(dict(weights))  # of the extra
    return written


def _check_class(run: RecordedRun) -> None:
    """Check the name of the class, which stands in the programs of the card; a run may be a stranger's.

    Raises:
        RunError: it is no name.
    """
    name = run.record.task.contract.class_name
    if not name.isidentifier() or keyword.iskeyword(name):
        raise RunError(repr(name)[:100], place=f"{run.path}/run.json, class_name", expected="a name that Python allows")


def _check_packages() -> None:
    if missing := [name for name in PACKAGES if find_spec(name) is None]:
        raise ConfigError(
            f"no {listed(missing)}",
            place="tacevo export",
            expected=f"the packages {listed(PACKAGES)}",
            remedy=install("export"),
        )


def _check_size(line: CandidateLine, networks: int) -> None:
    """Refuse what is too large by its parameters alone, before hours of training; its buffers are not known yet."""
    mib = 4 * (line.parameters or 0) / 2**20  # as float32
    if mib > (most := CHILD.total_bytes / 2**20):
        got, remedy = f"weights of {mib:.0f} MiB", "choose a smaller network"
        raise RunError(got, place=line.id, expected=f"at most {most:.0f} MiB, as a sandbox may answer", remedy=remedy)
    if networks * mib > (most := LARGEST / 2**20):
        got, remedy = f"{networks} networks of {mib:.0f} MiB", f"seeds={int(most / mib)} is the most"
        raise RunError(got, place="seeds", expected=f"at most {most:.0f} MiB of weights", remedy=remedy)


def _check_absent(target: Path) -> None:
    if target.exists() or target.is_symlink():
        raise ConfigError(
            "one that exists", place=str(target), expected="a directory to be made", remedy="name another by -o"
        )


def _make_parent(target: Path) -> None:
    """Make the directory that the export is made in, and write to it, before hours of training."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        Path(tempfile.mkdtemp(dir=target.parent)).rmdir()
    except OSError as error:
        got, expected = f"one that cannot ({error.strerror})", "a directory that can be written to"
        raise ConfigError(got, place=str(target.parent), expected=expected) from error


def _write(target: Path, files: Mapping[str, bytes]) -> None:
    """Write a directory: out of sight first, then with its name."""
    with new_directory(target) as stage:
        for name, content in files.items():
            (stage / name).write_bytes(content)
        _check_absent(target)
