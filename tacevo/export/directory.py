"""A candidate exported: trained again, converted, checked, and written as a directory in one step.

What it promises: this process never runs the class; the directory is whole or absent; no weight is pickled.
"""

import tempfile
from collections.abc import Mapping
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from tacevo.data.staging import new_directory
from tacevo.environment import install
from tacevo.errors import ConfigError, RunError
from tacevo.evolution.lines import CandidateLine
from tacevo.export.card import card
from tacevo.export.contents import PACKAGES, Exported, config_of, latency_of, run_of
from tacevo.export.conversion import ENTRIES, EQUIP, FORMS, convert
from tacevo.export.trainings import ExportSettings, design, train
from tacevo.gate.imports import with_imports
from tacevo.results.run import RecordedRun
from tacevo.runs.datasets import load_same, source_of
from tacevo.runs.progress import Progress
from tacevo.runs.wiring import check_means
from tacevo.sandbox.client import Sandbox
from tacevo.sandbox.protocol import CHILD
from tacevo.storage.canonical import readable
from tacevo.text import listed
from tacevo.training.numerics import environment

#: Bytes of all weights of an ensemble; twice as many may come as a file.
LARGEST = 512 * 2**20


def export(
    run: RecordedRun,
    line: CandidateLine,
    target: Path,
    settings: ExportSettings,
    *,
    bundle: str | None,
    retrained: bool,
    view: Progress,
) -> Exported:
    """Train a candidate again and write it as a directory; return what it says.

    The run is finished, and the candidate was admitted. `bundle` is the digest of the bundle that the run lies in; None
    of a directory. With `retrained`, a training that is not recorded, or goes otherwise, is an error.

    Raises:
        ConfigError: the target exists; or packages of the extra are missing; or this machine cannot train so.
        DataError: the data set is missing, or is another one.
        DivergenceError: with `retrained`, a training is not as recorded.
        RunError: with `retrained`, one is not recorded; or the source was edited, the network is too large, does not
            train to the end, or cannot be written in these forms.
        SandboxError: the sandbox is broken.
    """
    _check_packages()
    _check_absent(target)
    _check_size(line, settings.seeds)
    plan = design(run, line, settings)
    check_means(plan.config)
    source = run.directory.read_source(line.id, str(line.source))
    _make_parent(target)
    catalogue = source_of(plan.config).catalogue()
    data = load_same(plan.config, run.record.data, view, catalogue=catalogue)
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
        answer_bytes=2 * LARGEST,
    ) as sandbox:
        for form in FORMS:
            view.say(f"model.{form}: checking {len(data.test)} test images")
            model.files[form] = convert(
                sandbox, form, source, data=data, contract=model.contract, weights=model.weights, expected=model.outputs
            )
    _write(target, _contents(model, with_imports(source)))
    return model


def _contents(model: Exported, source: str) -> dict[str, bytes]:
    """Return all files by name."""
    texts = {
        "model.py": source,
        "config.json": readable(config_of(model)),
        "latency.json": readable(latency_of(model)),
        "run.json": readable(run_of(model)),
        "README.md": card(model),
    }
    as_safetensors = import_module("safetensors.numpy").save  # of the extra
    weights = {name: as_safetensors(dict(one)) for name, one in zip(model.weight_files, model.weights, strict=True)}
    files = {f"model.{form}": converted.file for form, converted in model.files.items()}
    return {name: text.encode() for name, text in texts.items()} | weights | files


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
