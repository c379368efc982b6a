"""A task of one's own: settings and texts of another task, copied under a new name."""

import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from tacevo.config.compose import compose
from tacevo.config.conf_folder import config_roots, groups, own_root, read_named
from tacevo.config.schema import TaskConfig
from tacevo.config.strict_yaml import read_yaml
from tacevo.config.supplement import read_supplement
from tacevo.errors import ConfigError
from tacevo.records import to_json

#: The files of a task, by the settings that name them.
_FILES = {"baseline": "baseline.py", "instructions": "instructions.yaml", "system": "system.md"}

#: The words that Hydra reads as another value than text.
_VALUES = frozenset({"null", "true", "false", "inf", "nan"})


def write_task(name: str, like: str, supplement: Path | None = None) -> TaskConfig:
    """Write `task/NAME.yaml` and `library/NAME/` into the user's configs (`own_root`), copied from a task it is like.

    With the authors' supplement, it is the task that it is like, `force` or `grating`, with their prompts.

    Both are there in full afterwards, or neither is. The settings come last, without which no search can choose what
    a process left that was killed. The files of the task that is returned are named relative to the configs.

    Raises:
        ConfigError: the name is not a lower-case identifier (hyphens may join its parts), or is taken; there is no task
            to be like, or no prompt for it; or the directory cannot be written to.
    """
    root = own_root()
    if not re.fullmatch(r"[a-z][a-z0-9_]*(-[a-z0-9_]+)*", name) or name in _VALUES:
        expected = "a lower-case identifier, which is not a value such as null or true"
        raise ConfigError(repr(name), place="NAME", expected=expected, remedy="choose a name such as shear")
    settings, texts = root / "task" / f"{name}.yaml", root / "library" / name
    for path in (each / part for each in (root, *config_roots()) for part in (f"task/{name}.yaml", f"library/{name}")):
        if path.exists():
            expected, remedy = "a name that no task has", "choose another, or remove what is there"
            raise ConfigError(f"{name}, and {path} exists", place="NAME", expected=expected, remedy=remedy)
    known = groups()["task"] if supplement is None else ["force", "grating"]
    if like not in known:
        remedy = "name the task whose files are to be copied"
        raise ConfigError(repr(like), place="--like", expected=f"one of {', '.join(known)}", remedy=remedy)
    old = compose([f"task={like}"]).task
    files: dict[str, Any] = {key: f"library/{name}/{file}" for key, file in _FILES.items()}
    new = replace(old, name=name if supplement is None else old.name, **files)
    as_yaml = yaml.safe_dump(to_json(new), sort_keys=False, default_flow_style=None, allow_unicode=True)
    texts_of = {key: read_named(f"task.{key}", getattr(old, key)) for key in files}
    if supplement is not None:
        library = read_yaml(texts_of["instructions"], only_text=True)
        ours = {key: library[key] for key in library if key != "mutations"}
        texts_of |= read_supplement(supplement, like, ours)
    copies = {path: texts_of[key] for key, path in files.items()}
    try:
        for folder in (settings.parent, texts.parent):
            folder.mkdir(parents=True, exist_ok=True)
        texts.mkdir()  # refused by the system where another process was quicker
        try:
            for path, text in {**copies, f"task/{name}.yaml": as_yaml}.items():
                (root / path).write_text(text, encoding="utf-8")
        except BaseException:
            shutil.rmtree(texts)
            settings.unlink(missing_ok=True)
            raise
    except OSError as error:
        got, remedy = f"{error.strerror}; nothing was written", "make room there, or let yourself write there"
        raise ConfigError(got, place=str(root), expected="a directory that can be written to", remedy=remedy) from error
    return new
