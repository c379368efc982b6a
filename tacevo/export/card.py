"""The model card of an exported network, README.md as Hugging Face reads it; pure."""

from dataclasses import asdict
from pathlib import Path
from statistics import median
from string import Template

from tacevo.choices import DataSource
from tacevo.data.labels import plain_name
from tacevo.environment import machine, versions
from tacevo.export.contents import RUNTIMES, Exported, spread_of
from tacevo.export.conversion import BOUND
from tacevo.export.trainings import Like
from tacevo.text import listed, printable

_ONNX = """\
import json
import numpy as np
import onnxruntime
from PIL import Image

config = json.load(open("config.json"))
image = Image.open("image.png").convert("RGB")
image = image.resize((config["input"]["size"],) * 2, Image.Resampling.BILINEAR)
pixels = np.asarray(image, np.float32).transpose(2, 0, 1)[None]  # 1 x 3 x size x size, 0 to 255
[output] = onnxruntime.InferenceSession("model.onnx").run(None, {"images": pixels})[0]
"""

_TORCH = (
    _ONNX.replace("import onnxruntime", "import torch")
    .replace("onnxruntime.InferenceSession", "torch.export.load")
    .replace('"model.onnx").run(None, {"images": pixels})[0]', '"model.pt2").module()(torch.from_numpy(pixels))')
)

_CLASS = """\
import json
from safetensors.torch import load_file
from model import {name}  # runs what a language model wrote

config = json.load(open("config.json"))
network = {name}(**config["arguments"])
network.load_state_dict(load_file(config["weights"][0]))"""

_SHOW_VALUES = """\
for name, unit, value in zip(config["outputs"]["names"], config["outputs"]["units"], output):
    print(f"{name} {value:.4g} {unit}")"""

_SHOW_CLASS = 'print(config["outputs"]["names"][output.argmax()], f"{output.max():.3f}")'


def card(model: Exported) -> str:
    """Write the card from its template, `card.template.md`."""
    template = Template((Path(__file__).parent / "card.template.md").read_text(encoding="utf-8"))
    return printable(template.substitute(_facts(model) | _examples(model) | _tested(model) | _trained(model)))


def _facts(model: Exported) -> dict[str, object]:
    """Return what the run, the data and the contract say."""
    run, facts, source = model.run, model.data.facts, model.plan.config.data.source
    train, validation, tests = facts.counts
    names = list(map(plain_name, facts.names, model.units or ("",) * facts.outputs))
    if model.is_regression:
        told = listed(
            [f"{name} ({unit or 'unit not recorded'})" for name, unit in zip(names, model.units, strict=True)]
        )
        purpose, output = f"reads {told} from an image", f"{told}, as recorded"
    else:
        purpose = f"tells {facts.outputs} classes apart in images"
        output = "the probability of each class, in the order of `config.json`"
    return {
        "licence": model.licence.lower(),
        "kind": facts.kind.value,
        "name": f"{run.name}-{model.line.id}",
        "task": run.task,
        "purpose": purpose,
        "candidate": model.line.id,
        "run": run.name,
        "size": facts.image_size,
        "outputs": facts.outputs,
        "output": output,
        "source": f"data={source.value}",
        "train": train,
        "validation": validation,
        "tests": tests,
        "fingerprint": facts.fingerprint,
        "sensor": "of a simulated sensor, not of a real one" if source is DataSource.simulated else "recorded",
        "digest": run.digest,
        "bundle": f", bundle `{model.bundle}`" if model.bundle else "",
        "source_sha256": model.line.source,
        "rules": listed([f"{part} {number}" for part, number in asdict(run.rules).items()]),
        "version": versions()["tacevo"],
    }


def _examples(model: Exported) -> dict[str, object]:
    """Return the programs that read one image."""
    show = _SHOW_VALUES if model.is_regression else _SHOW_CLASS
    return {
        "onnx_example": _ONNX + show,
        "torch_example": _TORCH + show,
        "class_example": _CLASS.format(name=model.contract.class_name),
    }


def _tested(model: Exported) -> dict[str, object]:
    """Return the metrics, differences and times."""
    metrics, files = model.metrics.items(), model.files
    times = [files[form].milliseconds for form in RUNTIMES]
    count = len(model.trained)
    return {
        "metrics": "\n".join(
            f"| {name} | {value:.4g} | {low:.4g} to {high:.4g} |" for name, (value, low, high) in metrics
        ),
        "yaml_metrics": "\n".join(f"    - type: {name}\n      value: {value}" for name, (value, _, _) in metrics),
        "differences": listed([f"{made.difference:.1g} (model.{form})" for form, made in files.items()]),
        "bound": f"{BOUND:g}",
        "tested": "one training" if count == 1 else f"an ensemble of {count} trainings",
        "study": _studied(model),
        "cpu": machine()["cpu"],
        "runtimes": " | ".join(RUNTIMES.values()),
        "latency": "\n".join(
            f"| {size} | {' | '.join(f'{median(each[size]):.3g}' for each in times)} |" for size in times[0]
        ),
    }


def _studied(model: Exported) -> str:
    """Say what the study of this network found with all of its seeds."""
    if len(model.plan.scores) < 2:
        return "No study of the run trained this network so with several seeds: another seed may give other figures."
    told = []
    for name in ("mse", "r2") if model.is_regression else ("accuracy", "macro_f1"):
        spread = spread_of([score.metrics[name] for score in model.plan.scores])
        told.append(f"{name} {spread['median']:.4g} ({spread['lower_quartile']:.4g} to {spread['upper_quartile']:.4g})")
    return f"Over {len(model.plan.scores)} seeds the run's study found, as median and quartiles: {listed(told)}."


def _trained(model: Exported) -> dict[str, object]:
    """Return how it was trained, and whether it went as recorded."""
    plan, training, trained = model.plan, model.plan.config.training, model.trained
    like = "the run's study" if plan.study is not None else f"a {plan.like.value} of TacEvo"
    which = "last" if plan.like is Like.search else "best validation"
    return {
        "like": like,
        "epochs": training.epochs,
        "batch": training.batch_size,
        "rate": f"{training.learning_rate:g}",
        "which": f"{which} epoch ({listed([str(one.epoch) for one in trained])})",
        "seeds": listed([str(one.seed) for one in trained]),
        "numerics": f"{model.numerics.value}, {training.device.value}",
        "agreement": agreement(model),
        "command": f"seeds={len(trained)} epochs={training.epochs} like={plan.like.value}",
    }


def agreement(model: Exported) -> str:
    """Say whether the trainings went as the run or its study recorded them."""
    if differing := sorted({name for one in model.trained for name in one.differing}):
        return "; ".join([f"**not those of the record**: {listed(differing)} differ", *model.doubts])
    if all(one.was_recorded for one in model.trained):
        return "their SHA-256 after the last epoch is the recorded one, and all losses and predictions are, bit for bit"
    if model.plan.like is Like.search:
        return "not all of these trainings were recorded before, so there is nothing to compare them with"
    return "not all of these trainings were recorded before; each was trained twice, with equal bits"
