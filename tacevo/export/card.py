"""The model card of an exported network, README.md as Hugging Face reads it; pure."""

import re
import shlex
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from string import Template

import yaml

from tacevo.data.labels import plain_name
from tacevo.environment import machine, versions
from tacevo.export.contents import Exported, spread_of
from tacevo.export.conversion import BOUND, Converted
from tacevo.export.onnx_file import INPUT, OPSET
from tacevo.export.trainings import Like, Trained
from tacevo.parts.facts import source_facts
from tacevo.records import DataFacts
from tacevo.results.grouped import FEWEST, in_groups
from tacevo.text import as_code, counted, in_markdown, listed, printable

#: The conversion to RGB, as `tacevo.data.sources.image_files` does it; the second where files have more than 8 bits, or
#: a white point is set.
_TO_RGB = 'image = image.convert("RGB")'
_TO_RGB_OF_WIDE = """\
values = np.asarray(image if image.mode[0] in "IF" else image.convert("RGB"))
white = config["input"]["white_point"] or (255 if values.dtype == np.uint8 else 65535)
values = np.floor(values.astype(float) * 255 / white + 0.5)  # the white point becomes 255
image = Image.fromarray(values.clip(0, 255).astype(np.uint8)).convert("RGB")"""

_PIXELS = """\
image = ImageOps.exif_transpose(Image.open("image.png"))
{to_rgb}
image = image.resize((config["input"]["size"],) * 2, Image.Resampling.BILINEAR)
pixels = np.asarray(image, np.float32).transpose(2, 0, 1)[None]  # 1 x 3 x size x size, 0 to 255"""

#: The code that turns the networks' outputs into those of `model.onnx`.
_FINISH_VALUES = """\
scale, offset = (torch.tensor(config["outputs"][name]) for name in ("scale", "offset"))
output = (torch.stack(outputs).mean(dim=0) * scale + offset).numpy()"""

_FINISH_CLASS = "output = torch.softmax(torch.stack(outputs), dim=1).mean(dim=0).numpy()"

_SHOW_VALUES = """\
for name, unit, value in zip(config["outputs"]["names"], config["outputs"]["units"], output):
    title = name.removesuffix(f"_{unit}") if unit else name  # depth_mm states its unit
    print(f"{title} {value:.4g} {unit}".rstrip())"""

_SHOW_CLASS = 'print(config["outputs"]["names"][output.argmax()], f"{output.max():.3f}")'


def card(model: Exported) -> str:
    """Write the card from its templates, `card.template.md` and what stands in it of an ONNX file.

    Whatever a stranger may have written goes through `in_markdown` or `as_code` here.
    """
    facts = _facts(model) | _tested(model) | _trained(model)
    examples = _examples(model)
    body = _template("card").substitute(
        facts,
        head=_head(model),
        **examples,
        onnx=_onnx(model, examples),
        metrics=_metrics(model),
        latency=_latency(model.onnx),
    )
    return printable(re.sub(r" +$", "", body, flags=re.MULTILINE))


def _template(name: str) -> Template:
    return Template((Path(__file__).parent / f"{name}.template.md").read_text(encoding="utf-8"))


def _onnx(model: Exported, examples: dict[str, str]) -> str:
    """Say how the ONNX file is used, or why there is none."""
    if model.onnx is None:
        return f"There is no `model.onnx`: {in_markdown(model.without_onnx)}."
    return _template("card_onnx").substitute(examples, input=INPUT, opset=OPSET).rstrip()


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
    units = list(model.units) or [""] * facts.outputs
    names = [in_markdown(plain_name(name, unit)) for name, unit in zip(facts.names, units, strict=True)]
    if model.is_regression:
        of_names = [in_markdown(unit) or "unit not recorded" for unit in units]
        told = listed([f"{name} ({unit})" for name, unit in zip(names, of_names, strict=True)])
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
        "licence": in_markdown(model.settings.licence),
        "name": in_markdown(_name(model)),
        "purpose": purpose,
        "candidate": as_code(model.line.id),
        "run": in_markdown(run.name),
        "size": facts.image_size,
        "outputs": facts.outputs,
        "output": output,
        "given": given,
        "unsure": unsure,
        "scales": scales,
        "author": "people wrote it" if model.line.request is None else f"{in_markdown(run.model)} wrote it",
        "recorded": _recorded(model),
        "source": f"data={source}",
        "train": train,
        "validation": validation,
        "tests": tests,
        "in_groups": in_groups(facts),
        "fingerprint": as_code(facts.fingerprint),
        "sensor": "of a simulated sensor, not of a real one" if source_facts(source).is_made else "recorded",
        "digest": run.digest,
        "bundle": f"bundle `{model.bundle}`" if model.bundle else "not from a bundle",
        "source_sha256": as_code(str(model.line.source)),
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
        "pixels": _PIXELS.format(to_rgb=_TO_RGB_OF_WIDE if is_wide else _TO_RGB),
        "finish": _FINISH_VALUES if model.is_regression else _FINISH_CLASS,
        "show": _SHOW_VALUES if model.is_regression else _SHOW_CLASS,
        "class_name": model.contract.class_name,
    }


def _metrics(model: Exported) -> str:
    """Return the rows of the test metrics."""
    rows = []
    for name, unit in _shown(model).items():
        value, low, high = model.metrics[name]
        shown = f"{value:.4g} {in_markdown(unit)}".rstrip()
        rows.append(f"| {in_markdown(name)} | {shown} | {low:.4g} to {high:.4g} |")
    return "\n".join(rows)


def _latency(onnx: Converted | None) -> str:
    """Return the table of times of an ONNX file; nothing without one."""
    if onnx is None:
        return ""
    times = onnx.milliseconds
    rows = [f"| {size} | {_quartiles(passes, 3)} |" for size, passes in times.items()]
    passes = min(map(len, times.values()))
    said = (
        f"Milliseconds with one thread on {in_markdown(str(machine()['cpu']))}, as median (quartiles) of {passes} "
        "passes; other work on the machine counts, too:"
    )
    return "\n".join(["", said, "", "| images at once | onnxruntime (model.onnx) |", "|---|---|", *rows])


def _quartiles(values: Sequence[float], digits: int) -> str:
    spread = spread_of(values)
    median, low, high = (f"{spread[name]:.{digits}g}" for name in ("median", "lower_quartile", "upper_quartile"))
    return f"{median} ({low} to {high})"


def _tested(model: Exported) -> dict[str, object]:
    """Return differences, and what was tested."""
    count, built = len(model.trained), model.built
    assert built is not None  # it was tried
    differences = [f"{built.difference:.1g} (the class)"]
    differences += [] if model.onnx is None else [f"{model.onnx.difference:.1g} (model.onnx)"]
    return {
        "differences": listed(differences),
        "bound": f"{BOUND:g}",
        "resampled": _resampled(model.data.facts),
        "tested": "one training" if count == 1 else f"an ensemble of {count} trainings",
        "study": _studied(model),
    }


def _resampled(facts: DataFacts) -> str:
    """Say what the intervals resample, and whether there is enough of it."""
    if not facts.is_grouped:
        return "test images"
    few = f"; fewer than {FEWEST} are too few, and these intervals too narrow" if facts.units < FEWEST else ""
    return f"groups of test images that were recorded together ({counted(facts.units, 'group')}{few})"


def _studied(model: Exported) -> str:
    """Say what the study of this network found with all of its seeds, if that can be computed again."""
    differ = any(one.was_recorded and one.differing for one in model.trained)
    if why := model.plan.uncited or ("the trainings above did not go as it recorded them" if differ else ""):
        return f"What the run's study found is not cited, because it could not be checked: {in_markdown(why)}."
    if len(model.plan.scores) < 2:
        return "No study of the run trained this network so with several seeds: another seed may give other figures."
    told = []
    for name in ("mse", "r2") if model.is_regression else ("accuracy", "macro_f1"):
        told.append(f"{name} {_quartiles([score.metrics[name] for score in model.plan.scores], 4)}")
    study, count = model.plan.study, len(model.plan.scores)
    assert study is not None  # whose scores these are
    again = {one.key for one in model.trained if one.was_recorded} & {score.evaluation for score in model.plan.scores}
    others = "" if len(again) == count else f", and the other {count - len(again)} are the word of whoever made the run"
    return (
        f"{len(again)} of its {count} seeds {'was' if len(again) == 1 else 'were'} trained again here{others}: the "
        f"run's study found, as median and quartiles, {listed(told)}. This was computed again from its recorded test "
        "predictions and the labels of the data."
    )


def _trained(model: Exported) -> dict[str, object]:
    """Return how it was trained, and whether it went as recorded."""
    plan, training, trained = model.plan, model.plan.config.training, model.trained
    like = "the run's study" if plan.study is not None else f"a {plan.like.value} of TacEvo"
    given = [f"{name}={value}" for name, value in (asdict(model.settings) | {"epochs": training.epochs}).items()]
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
        "command": as_code(f"tacevo export RUN {shlex.quote(model.line.id)} -o DIR {' '.join(given)}"),
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
    return "; ".join([*told, *(map(in_markdown, model.doubts) if is_other else ())])


def _differing(trained: Sequence[Trained], what: str) -> str:
    """Say what differs in some trainings; empty where nothing does."""
    names = sorted({name for one in trained for name in one.differing or ()})
    return f"{what}: {listed(names)} differ" if names else ""


def _counted(trained: Sequence[Trained], model: Exported, what: str) -> str:
    """Say of how many of the trainings something holds, where it is not of all."""
    return what if len(trained) == len(model.trained) else f"{len(trained)} of {len(model.trained)}: {what}"
