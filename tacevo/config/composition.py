"""Hydra's composition of the files of conf/, without the groups that Hydra has for applications of its own.

`hydra.compose` reads every file each time, with nine groups of launchers, sweepers and logging that nothing here uses.
That is most of what a command waits for before it starts, and a sweep waits for it again for each arm. Here each file
is read once as long as it stays the same, and Hydra's own groups are left out. The classes are private ones of Hydra:
a test compares what comes out with `hydra.compose` for every choice that is shipped.
"""

import contextlib
import copy
import os
import sys
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from hydra import version
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.config_repository import ConfigRepository
from hydra._internal.core_plugins.file_config_source import FileConfigSource
from hydra._internal.core_plugins.structured_config_source import StructuredConfigSource
from hydra._internal.defaults_list import create_defaults_list
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import ConfigCompositionException
from hydra.plugins.config_source import ConfigResult
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

#: What tells the files of a directory of configs from other ones, or from what they were: the path of each, and its
#: inode, times of change in ns, and size in bytes.
_Stamps = tuple[tuple[str, int, int, int, int], ...]


class _Files(ConfigRepository):
    """The files of directories of configs, each read once, and what Hydra's store of configs holds by name."""

    def __init__(self, roots: Sequence[Path]) -> None:
        files = [FileConfigSource("main", f"file://{root}") for root in roots]
        self.sources = [*files, StructuredConfigSource("schema", "structured://")]
        self.read: dict[str, ConfigResult | None] = {}

    def load_config(self, config_path: str) -> ConfigResult | None:
        """Return a config as an object of its own, or None."""
        if config_path not in self.read:
            self.read[config_path] = super().load_config(config_path)
        return copy.deepcopy(self.read[config_path])


class _Once(ConfigRepository):
    """The configs of one composition, read from the files: one object each, which Hydra changes as it goes."""

    def __init__(self, files: _Files) -> None:
        self.sources = files.sources
        self._files = files
        self._loaded: dict[str, ConfigResult | None] = {}

    def load_config(self, config_path: str) -> ConfigResult | None:
        """Return a config, each time the same object, or None."""
        if config_path not in self._loaded:
            self._loaded[config_path] = self._files.load_config(config_path)
        return self._loaded[config_path]


class _Loader(ConfigLoaderImpl):
    """Hydra's loader over such files."""

    def __init__(self, files: _Files) -> None:  # not Hydra's own: it looks for plugins, which nothing here uses
        self.repository: _Files = files

    def get_group_options(self, group_name: str, *args: Any, **kwargs: Any) -> list[str]:
        """Return the choices of a group, which a sweep may name by a pattern."""
        return self.repository.get_group_options(group_name)

    def composed(self, name: str, overrides: Sequence[str]) -> tuple[DictConfig, dict[str, str | None]]:
        """Do what Hydra's `load_configuration` does, but for its own groups."""
        parsed = OverridesParser.create().parse_overrides(list(overrides))
        self.validate_sweep_overrides_legal(parsed, run_mode=RunMode.RUN, from_shell=False)
        once = _Once(self.repository)
        listed = create_defaults_list(once, name, parsed, prepend_hydra=False, skip_missing=False)
        config = self._compose_config_from_defaults_list(listed.defaults, once)
        config.pop("hydra", None)  # settings of Hydra's own in a user's file, which have no effect
        OmegaConf.set_struct(config, True)
        self._apply_overrides_to_config(listed.config_overrides, config)
        return config, dict(listed.overrides.known_choices)


def composed(name: str, overrides: Sequence[str], roots: Sequence[Path]) -> tuple[DictConfig, Mapping[str, str | None]]:
    """Compose a config of some directories; the same files and overrides give the same object again.

    Args:
        name: of the file of the first directory, without `.yaml`.
        overrides: as Hydra reads them, each with one value.
        roots: the directories, the first of which has each file that two of them have.

    Returns:
        The config, in which `${...}` is not resolved; nobody changes it. And the choice of each group.

    Raises:
        Exception: of Hydra, OmegaConf, YAML or the file system, which share no class.
    """
    # The choice of a group may name a variable of the environment: in an override, or in a file of the user's.
    names_variables = len(roots) > 1 or any("${" in override for override in overrides)
    environment = frozenset(os.environ.items()) if names_variables else frozenset[tuple[str, str]]()
    return _composed(name, tuple(overrides), tuple(roots), tuple(map(_stamps, roots)), environment)


def laid_over(settings: Mapping[str, Any], overrides: Sequence[str]) -> DictConfig:
    """Lay overrides over settings, each of which must be there; raises as `composed`."""
    config = OmegaConf.create(dict(settings))
    OmegaConf.set_struct(config, True)
    read = OverridesParser.create().parse_overrides(list(overrides))
    ConfigLoaderImpl.validate_sweep_overrides_legal(read, run_mode=RunMode.RUN, from_shell=False)
    ConfigLoaderImpl._apply_overrides_to_config(read, config)
    return config


def parsed(overrides: Sequence[str], roots: Sequence[Path]) -> list[Override]:
    """Read overrides, each of which may stand for several values; raises as `composed`."""
    loader = _Loader(_files(tuple(roots), tuple(map(_stamps, roots))))
    return OverridesParser.create(config_loader=loader).parse_overrides(list(overrides))


@lru_cache(maxsize=128)
def _composed(
    name: str,
    overrides: tuple[str, ...],
    roots: tuple[Path, ...],
    stamps: tuple[_Stamps, ...],
    environment: frozenset[tuple[str, str]],
) -> tuple[DictConfig, Mapping[str, str | None]]:
    version.setbase("1.3")
    try:
        return _Loader(_files(roots, stamps)).composed(name, overrides)
    except OmegaConfBaseException as error:
        raise ConfigCompositionException().with_traceback(sys.exc_info()[2]) from error


@lru_cache(maxsize=4)
def _files(roots: tuple[Path, ...], stamps: tuple[_Stamps, ...]) -> _Files:
    return _Files(roots)


def _stamps(root: Path) -> _Stamps:
    stamps, seen = [], set[str]()
    for folder, below, files in os.walk(root, followlinks=True):
        real = os.path.realpath(folder)
        if real in seen:  # a link that leads back
            below.clear()
            continue
        seen.add(real)
        for file in files:
            if file.endswith(".yaml"):
                with contextlib.suppress(FileNotFoundError):  # a link to nothing, as an editor leaves beside its file
                    path = os.path.join(folder, file)
                    stat = os.stat(path)
                    stamps.append((path, stat.st_ino, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_size))
    return tuple(sorted(stamps))
