"""A task of one's own: settings and texts of another task, copied under a new name."""

import re
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import yaml

from tacevo.config.compose import compose
from tacevo.config.folder import checkout_root, groups, read_named
from tacevo.config.schema import TaskConfig
from tacevo.errors import ConfigError
from tacevo.records import to_json

#: What Hydra reads as another value than text.
_VALUES = frozenset({"null", "true", "false", "inf", "nan"})


def write_task(name: str, like: str) -> TaskConfig:
    """Write `task/NAME.yaml` and `library/NAME/` into conf/, copied from the task that it is like.

    Both are there in full afterwards, or neither is. They are filled out of sight and renamed; only a process that is
    killed between the two names leaves the directory without the settings, which no search can choose.

    Returns:
        The new task; its files are named relative to conf/.

    Raises:
        ConfigError: tacevo is installed and not a checkout; the name is not a lower-case identifier, or is taken; there
            is no task to be like; or conf/ cannot be written to.
    """
    root = checkout_root()
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or name in _VALUES:
        expected = "a lower-case identifier, which is not a value such as null or true"
        raise ConfigError(repr(name), place="NAME", expected=expected, remedy="choose a name such as shear")
    settings, texts = root / "task" / f"{name}.yaml", root / "library" / name
    for path in (settings, texts):
        if path.exists():
            expected, remedy = "a name that no task has", "choose another, or remove what is there"
            raise ConfigError(f"{name}, and {path} exists", place="NAME", expected=expected, remedy=remedy)
    known = groups()["task"]
    if like not in known:
        remedy = "name the task whose files are to be copied"
        raise ConfigError(repr(like), place="--like", expected=f"one of {', '.join(known)}", remedy=remedy)
    old = compose([f"task={like}"]).task
    new = replace(
        old,
        name=name,
        baseline=f"library/{name}/baseline.py",
        instructions=f"library/{name}/instructions.yaml",
        system=f"library/{name}/system.md",
    )
    as_yaml = yaml.safe_dump(to_json(new), sort_keys=False, default_flow_style=None, allow_unicode=True)
    try:
        with tempfile.TemporaryDirectory(prefix=f".{name}.", dir=texts.parent) as hidden:
            stage, written = Path(hidden) / name, Path(hidden) / settings.name
            stage.mkdir()
            for key in ("baseline", "instructions", "system"):
                text = read_named(f"task.{key}", getattr(old, key))
                (stage / Path(getattr(new, key)).name).write_text(text, encoding="utf-8")
            written.write_text(as_yaml, encoding="utf-8")
            stage.rename(texts)  # refused by the system where another process was quicker
            try:
                written.rename(settings)
            except OSError:
                shutil.rmtree(texts)
                raise
    except OSError as error:
        got, remedy = f"{error.strerror}; nothing was written", "make room there, or let yourself write there"
        raise ConfigError(got, place=str(root), expected="a directory that can be written to", remedy=remedy) from error
    return new
