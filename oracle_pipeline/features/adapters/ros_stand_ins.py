"""Just enough of ``rclpy`` and ``rosidl_runtime_py`` for the thesis's plugins to decode messages.

Those plugins import both to turn the bytes that ``cur`` gives into messages. Where ROS is
installed it is used; elsewhere these stand in, while plugins load and run, and only then.
"""

import contextlib
import importlib.util
import sys
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from types import ModuleType
from typing import Any

import numpy as np

from oracle_pipeline.bags.types import deserialize


@contextlib.contextmanager
def stand_ins() -> Iterator[None]:
    """Replace modules that are not installed, inside the block."""
    absent = {
        name: module
        for name, module in _modules().items()
        if importlib.util.find_spec(name.partition(".")[0]) is None
    }
    sys.modules.update(absent)
    try:
        yield
    finally:
        for name in absent:
            del sys.modules[name]


def _get_message(identifier: str) -> str:
    """Stand in for ``rosidl_runtime_py.utilities.get_message``; a type's name is enough here."""
    return identifier


def _message_to_ordereddict(message: Any) -> "OrderedDict[str, Any]":
    """Stand in for ``rosidl_runtime_py.convert.message_to_ordereddict``."""
    return OrderedDict((f.name, _plain(getattr(message, f.name))) for f in fields(message))


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return _message_to_ordereddict(value)
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list):
        return [_plain(each) for each in value]
    return value


def _modules() -> dict[str, ModuleType]:
    contents: dict[str, dict[str, Any]] = {
        "rclpy.serialization": {"deserialize_message": deserialize},
        "rosidl_runtime_py.utilities": {"get_message": _get_message},
        "rosidl_runtime_py.convert": {"message_to_ordereddict": _message_to_ordereddict},
    }
    modules: dict[str, ModuleType] = {}
    for name, attributes in contents.items():
        package, _, last = name.partition(".")
        modules[name] = ModuleType(name)
        vars(modules[name]).update(attributes)
        setattr(modules.setdefault(package, ModuleType(package)), last, modules[name])
    return modules
