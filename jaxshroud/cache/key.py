"""What a compiled program depends on, as text: two programs with the same text are the same program.

What is not known to be described completely, such as functions of a user, is an `UnknownPartError`: a program that has
such a part is not kept.
"""

import hashlib
import os
import platform
import sys
from enum import Enum
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from inspect import isfunction
from pathlib import Path
from types import ModuleType
from typing import Any

import jax
import numpy as np
import psutil

PACKAGE = Path(__file__).parents[1]
VERSIONS_OF = ("jax", "jaxlib", "numpy", "scipy", "equinox", "diffrax", "jaxtyping")
# Options of JAX without influence on what is traced and compiled.
WITHOUT_INFLUENCE = ("compilation_cache", "persistent_cache", "logging", "log_", "explain", "traceback", "pprint")
TRUSTED_TYPES = ("jaxshroud", "jax", "equinox", "builtins")  # packages whose static data are described by their fields


class UnknownPartError(Exception):
    """A program depends on something that cannot be described."""


class OwnPartError(UnknownPartError):
    """That is a value of this package: a mistake here, by which the program would be compiled at every start."""


def description(value: Any) -> str:
    """A static value as text.

    Raises:
        UnknownPartError: It has a part of a kind that is not known to be described completely.
        OwnPartError: That part is of this package.
    """
    match value:
        case None | bool() | int() | str() | bytes():
            return repr(value)
        case float():
            return value.hex()
        case Enum():
            return f"{_name(type(value))}.{value.name}"
        case np.dtype():
            return value.str
        case tuple() | list():
            return f"{_name(type(value))}({','.join(map(description, value))})"
        case dict():
            return f"{{{','.join(f'{description(k)}:{description(v)}' for k, v in value.items())}}}"
        case frozenset() | set():
            return f"{{{','.join(sorted(map(description, value)))}}}"
        case type() | ModuleType():
            return _name(value)
        case _ if isfunction(value):
            return _function_name(value)
        case _ if type(value).__module__.split(".")[0] == "equinox" and not getattr(value, "__dict__", None):
            return _name(type(value))  # its mark of a missing field
    is_own = type(value).__module__.split(".")[0] == "jaxshroud"
    raise (OwnPartError if is_own else UnknownPartError)(f"{type(value).__name__} {value!r}"[:200])


def _name(of: Any) -> str:
    """The full name of a type or a module of a package that is known."""
    full = of.__name__ if isinstance(of, ModuleType) else f"{of.__module__}.{of.__qualname__}"
    if full.split(".")[0] not in TRUSTED_TYPES or "<locals>" in full:
        raise UnknownPartError(full)
    return full


def _function_name(function: Any) -> str:
    """The full name of a function that this package defines under that name."""
    found = getattr(sys.modules.get(function.__module__), function.__qualname__, None)
    if found is not function or not function.__module__.startswith("jaxshroud."):
        raise UnknownPartError(f"function {function.__qualname__}")
    return f"{function.__module__}.{function.__qualname__}"


@cache
def tree_description(structure: Any) -> str:
    """The structure of a tree as text, the static fields of its nodes included."""
    node = structure.node_data()
    if node is None:
        return "*" if structure.num_leaves else "None"
    kind, static = node
    inner = ",".join(map(tree_description, structure.children()))
    return f"{_name(kind)}[{description(static)}]({inner})"


@cache
def surroundings() -> str | None:
    """Sources, versions and processor as text; None if the sources are not those of this process."""
    sources = source_hash()
    if sources is None:
        return None
    device = jax.devices()[0]
    machine = (platform.machine(), processor_features(), device.device_kind, device.client.platform_version)
    return "\n".join([f"sources {sources}", *map(_version, VERSIONS_OF), sys.version, *machine])


def settings() -> tuple:
    """The options of JAX and XLA of the moment that tracing and compilation see."""
    values = (getattr(jax.config, name, None) for name in _influential_options())
    plain = (value if isinstance(value, bool | int | float | str | type(None)) else str(value) for value in values)
    return (*plain, os.environ.get("XLA_FLAGS", ""), jax.device_count(), jax.default_backend())


@cache
def _influential_options() -> list[str]:
    return [name for name in sorted(jax.config.values) if not any(word in name for word in WITHOUT_INFLUENCE)]


def source_hash() -> str | None:
    """A hash of the sources of the package; None if one was changed after this process began, which may run others."""
    files = sorted(PACKAGE.rglob("*.py"))
    if max(os.stat(path).st_ctime for path in files) >= psutil.Process().create_time():
        return None
    total = hashlib.sha256()
    for path in files:
        content = path.read_bytes()
        total.update(f"{path.relative_to(PACKAGE)} {len(content)}\n".encode())
        total.update(content)
    return total.hexdigest()


def processor_features() -> str:
    """The instructions that the processor knows."""
    try:
        text = Path("/proc/cpuinfo").read_text("utf-8", "replace")
    except OSError:
        return platform.processor()
    first = text.split("\n\n")[0].splitlines()
    wanted = ("vendor_id", "cpu family", "model", "stepping", "flags", "Features", "CPU ")
    return "\n".join(line for line in first if line.startswith(wanted))


def _version(package: str) -> str:
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return f"{package} absent"
