"""The model card of an exported network, README.md as Hugging Face reads it; pure."""

import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from string import Template

import yaml

from tacevo.choices import DataSource
from tacevo.data.labels import plain_name
from tacevo.environment import machine, versions
from tacevo.export.contents import RUNTIMES, Exported, spread_of
from tacevo.export.conversion import BOUND, OPSET
from tacevo.export.trainings import Like, Trained
from tacevo.text import counted, listed, printable

#: As `tacevo.data.sources.image_files` does it; the second where files have more than 8 bits, or a white point is set.
_TO_RGB = 'image = image.convert("RGB")'
_TO_RGB_OF_WIDE = """\
values = np.asarray(image if image.mode[0] in "IF" else image.convert("RGB"))
white = config["input"]["white_point"] or (255 if values.dtype == np.uint8 else 65535)
values = np.floor(values.astype(float) * 255 / white + 0.5)  # the white point becomes 255
image = Image.fromarray(values.clip(0, 255).astype(np.uint8)).convert("RGB")"""

_SHOW_VALUES = """\
for name, unit, value in zip(config["outputs"]["names"], config["outputs"]["units"], output):
    print(f"{name} {value:.4g} {unit}")"""

_SHOW_CLASS = 'print(config["outputs"]["names"][output.argmax()], f"{output.max():.3f}")'


def card(model: Exported) -> str:
    """Write the card from its template, `card.template.md`."""
    template = Template((Path(__file__).parent / "card.template.md").read_text(encoding="utf-8"))
    facts = _facts(model) | _tested(model) | _trained(model)
    body = template.substitute(facts, head=_head(model), **_tables(model), **_examples(model))
    return printable(re.sub(r" +$", "", body, flags=re.MULTILINE))


def _plain(text: str) -> str:
    """Return a text as one line that begins no HTML, link, cell or code of Markdown."""
    return re.sub(r"([<|\[])", r"\\\1", " ".join(text.replace("`", "'").split()))


def _shown(model: Exported) -> dict[str, str]:
    """Return the metrics that a reader needs, by name, with their units; empty in those of training."""
    if not model.is_regression:
        return dict.fromkeys(model.metrics, "")
    shown: dict[str, str] = {}
    for name, unit in zip(model.data.facts.names, model.units, strict=True):
        shown |= {f"recorded_mae_{name}": unit, f"recorded_rmse_{name}": unit, f"r2_{name}": ""}
    return shown | dict.fromkeys(("mse", "mae", "rmse", "r2"), "")


def _name(model: Exported) -> str:
    return f"{model.run.name}-{model.line.id}"


def _head(model: Exported) -> str:
    """Return what Hugging Face reads of the card, as YAML."""
    kind = f"image-{model.data.facts.kind.value}"
    result = {
        "task": {"type": kind},
        "dataset": {"type": "tacevo", "name": model.run.task},
        "metrics": [{"type": name, "value": float(model.metrics[name][0])} for name in _shown(model)],
    }
    head = {
        "license": model.settings.licence.lower(),
        "library_name": "pytorch",
        "tags": ["tactile-sensing", "neural-architecture-search", "tacevo", kind],
        "model-index": [{"name": _name(model), "results": [result]}],
    }
    return yaml.safe_dump(head, sort_keys=False, allow_unicode=True, width=1000)


def _facts(model: Exported) -> dict[str, object]:
    """Return what the run, the data and the contract say."""
    run, facts, source = model.run, model.data.facts, model.plan.config.data.source
    train, validation, tests = facts.counts
    units = list(map(_plain, model.units)) or [""] * facts.outputs
    names = [_plain(plain_name(name, unit)) for name, unit in zip(facts.names, units, strict=True)]
    if model.is_regression:
        told = listed([f"{name} ({unit or 'unit not recorded'})" for name, unit in zip(names, units, strict=True)])
        purpose, output = f"reads {told} from an image", f"{told}, as recorded"
        given, unsure = "values that scale and offset turn into these", "does not say how sure it is"
        scales = (
            "`recorded_` is in units of the recording; `mse`, `mae` and `rmse` are of labels scaled as in training."
        )
    else:
        purpose = f"tells {facts.outputs} classes apart in images"
        output, scales = f"the probability of each class: {listed(names)}", ""
        given, unsure = "logits", "its probabilities were not calibrated"
    return {
        "licence": model.settings.licence,
        "name": _plain(_name(model)),
        "purpose": purpose,
        "candidate": model.line.id,
        "run": _plain(run.name),
        "size": facts.image_size,
        "outputs": facts.outputs,
        "output": output,
        "given": given,
        "unsure": unsure,
        "scales": scales,
        "author": "people wrote it" if model.line.request is None else f"{_plain(run.model)} wrote it",
        "recorded": _recorded(model),
        "source": f"data={source.value}",
        "train": train,
        "validation": validation,
        "tests": tests,
        "fingerprint": facts.fingerprint,
        "sensor": "of a simulated sensor, not of a real one" if source is DataSource.simulated else "recorded",
        "digest": run.digest,
        "bundle": f"bundle `{model.bundle}`" if model.bundle else "not from a bundle",
        "source_sha256": model.line.source,
        "rules": listed([f"{part} {number}" for part, number in asdict(run.rules).items()]),
        "version": versions()["tacevo"],
    }


def _recorded(model: Exported) -> str:
    """Say how large the images of the data were, and what became white."""
    size, white = model.catalogue.recorded_size, model.plan.config.data.white_point
    told = [] if size is None else ["{} x {} pixels before they were resized".format(*size)]
    told += [f"{bits} bits" for bits in sorted(set(model.catalogue.depths))]
    told += [] if white is None else [f"white at {white:g}"]
    return f"Those of the data: {listed(told)}." if told else ""


def _examples(model: Exported) -> dict[str, str]:
    """Return what the programs that read one image have of this network."""
    is_wide = model.plan.config.data.white_point is not None or max(model.catalogue.depths, default=8) > 8
    return {
        "to_rgb": _TO_RGB_OF_WIDE if is_wide else _TO_RGB,
        "show": _SHOW_VALUES if model.is_regression else _SHOW_CLASS,
        "class_name": model.contract.class_name,
    }


def _tables(model: Exported) -> dict[str, str]:
    """Return the rows of metrics and of times."""
    times = [model.files[form].milliseconds for form in RUNTIMES]
    rows = []
    for name, unit in _shown(model).items():
        value, low, high = model.metrics[name]
        rows.append(f"| {_plain(name)} | {value:.4g}{unit and f' {_plain(unit)}'} | {low:.4g} to {high:.4g} |")
    return {
        "metrics": "\n".join(rows),
        "runtimes": " | ".join(f"{runtime} (model.{form})" for form, runtime in RUNTIMES.items()),
        "latency": "\n".join(
            f"| {size} | {' | '.join(_quartiles(each[size], 3) for each in times)} |" for size in times[0]
        ),
        "passes": str(min(len(passes) for each in times for passes in each.values())),
    }


def _quartiles(values: Sequence[float], digits: int) -> str:
    spread = spread_of(values)
    median, low, high = (f"{spread[name]:.{digits}g}" for name in ("median", "lower_quartile", "upper_quartile"))
    return f"{median} ({low} to {high})"


def _tested(model: Exported) -> dict[str, object]:
    """Return differences, and what was tested on which machine."""
    count = len(model.trained)
    return {
        "differences": listed([f"{made.difference:.1g} (model.{form})" for form, made in model.files.items()]),
        "bound": f"{BOUND:g}",
        "opset": str(OPSET),
        "tested": "one training" if count == 1 else f"an ensemble of {count} trainings",
        "study": _studied(model),
        "cpu": machine()["cpu"],
    }


def _studied(model: Exported) -> str:
    """Say what the study of this network found with all of its seeds."""
    if len(model.plan.scores) < 2:
        return "No study of the run trained this network so with several seeds: another seed may give other figures."
    told = []
    for name in ("mse", "r2") if model.is_regression else ("accuracy", "macro_f1"):
        told.append(f"{name} {_quartiles([score.metrics[name] for score in model.plan.scores], 4)}")
    return f"Over {len(model.plan.scores)} seeds the run's study found, as median and quartiles: {listed(told)}."


def _trained(model: Exported) -> dict[str, object]:
    """Return how it was trained, and whether it went as recorded."""
    plan, training, trained = model.plan, model.plan.config.training, model.trained
    like = "the run's study" if plan.study is not None else f"a {plan.like.value} of TacEvo"
    settings = asdict(model.settings) | {"epochs": training.epochs}
    which = "last" if plan.like is Like.search else "best validation"
    return {
        "like": like,
        "epochs": counted(training.epochs, "epoch"),
        "batch": training.batch_size,
        "rate": f"{training.learning_rate:g}",
        "which": f"{which} epoch ({listed([str(one.epoch) for one in trained])})",
        "seeds": listed([str(one.seed) for one in trained]),
        "numerics": f"{model.numerics.value}, {training.device.value}",
        "agreement": agreement(model),
        "command": " ".join(f"{name}={value}" for name, value in settings.items()),
    }


def agreement(model: Exported) -> str:
    """Say whether the trainings went as recorded by the run or its study; else whether two went alike."""
    known = [one for one in model.trained if one.was_recorded]
    others = [one for one in model.trained if not one.was_recorded]
    again = [one for one in others if one.differing is not None]
    told = []
    if known:
        equal = "the SHA-256 after the last epoch, all losses and predictions are the recorded ones, bit for bit"
        told.append(_counted(known, model, _differing(known, "**not those of the record**") or equal))
    if again:
        equal = "not recorded before; trained twice, with equal bits"
        told.append(_counted(again, model, _differing(again, "not recorded before; **two trainings differ**") or equal))
    if rest := [one for one in others if one.differing is None]:
        told.append(_counted(rest, model, "not recorded before, so there is nothing to compare with"))
    is_other = any(one.differing for one in model.trained)
    return "; ".join([*told, *(model.doubts if is_other else ())])


def _differing(trained: Sequence[Trained], what: str) -> str:
    """Say what differs in some trainings; empty where nothing does."""
    names = sorted({name for one in trained for name in one.differing or ()})
    return f"{what}: {listed(names)} differ" if names else ""


def _counted(trained: Sequence[Trained], model: Exported, what: str) -> str:
    """Say of how many of the trainings something holds, where it is not of all."""
    return what if len(trained) == len(model.trained) else f"{len(trained)} of {len(model.trained)}: {what}"
