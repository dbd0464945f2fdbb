"""The process that runs one compiled plugin: a separate program without imports of the package.

``python compiled_process.py LIBRARY BYTES`` answers each line on standard input with one on
standard output, both JSON. ``{}`` requests the description; ``{"folder": ..., "start_s": ...,
"end_s": ..., "tables": [...]}`` the features of a window, whose tables are Arrow files in the
folder. The library's own output goes to standard error.
"""

import ctypes
import json
import os
import resource
import sys
from pathlib import Path
from typing import Any

VERSIONED = "oracle_plugin_v1"  # the entry function; its name has the version of the interface
SCHEMA_BYTES, ARRAY_BYTES = 72, 80  # of the structures of the Arrow C data interface
ERROR_BYTES = 1024


class _Table(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_char_p),
        ("schema", ctypes.c_void_p),
        ("array", ctypes.c_void_p),
    )


class _Window(ctypes.Structure):
    _fields_ = (
        ("start_s", ctypes.c_double),
        ("end_s", ctypes.c_double),
        ("n_tables", ctypes.c_int64),
        ("tables", ctypes.POINTER(_Table)),
    )


_COMPUTE = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.POINTER(_Window), ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p,
    ctypes.c_size_t,
)  # fmt: skip


class _Plugin(ctypes.Structure):
    _fields_ = (("description", ctypes.c_char_p), ("compute", _COMPUTE))


def main(library: str, memory: int) -> None:
    """Serve requests until standard input ends."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # keeps the library's own output out of the answers
    plugin: Any = None
    for line in sys.stdin:
        asked = json.loads(line)
        try:
            if plugin is None:
                plugin = _loaded(library)
            if asked:
                import pyarrow  # noqa: F401 -- before the limit: it reserves much address space

                resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
                answer: dict[str, Any] = {"features": _features(plugin, asked)}
            else:
                answer = {"description": plugin.description.decode()}
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def _loaded(library: str) -> Any:
    loaded = ctypes.CDLL(library)
    try:
        entry = loaded[VERSIONED]
    except AttributeError:
        raise ValueError(
            f"the library has no function {VERSIONED}; it is no plugin, or one for another version "
            "of oracle_plugin.h"
        ) from None
    entry.restype = ctypes.POINTER(_Plugin)
    return entry().contents


def _features(plugin: Any, asked: dict[str, Any]) -> dict[str, float | None]:
    """Call the plugin on the tables of one window."""
    import pyarrow as pa

    names = asked["tables"]
    tables = (_Table * len(names))()
    lent = []
    for table, name in zip(tables, names, strict=True):
        with pa.ipc.open_file(str(Path(asked["folder"]) / f"{name}.arrow")) as source:
            batch = source.get_batch(0)
        schema, array = _place(SCHEMA_BYTES), _place(ARRAY_BYTES)
        batch._export_to_c(ctypes.addressof(array), ctypes.addressof(schema))
        table.name = name.encode()
        table.schema, table.array = ctypes.addressof(schema), ctypes.addressof(array)
        lent.append((schema, array))
    window = _Window(asked["start_s"], asked["end_s"], len(names), tables)
    schema, array = _place(SCHEMA_BYTES), _place(ARRAY_BYTES)
    reason = ctypes.create_string_buffer(ERROR_BYTES)
    failed = plugin.compute(
        ctypes.byref(window), ctypes.addressof(schema), ctypes.addressof(array),
        ctypes.addressof(reason), ERROR_BYTES,
    )  # fmt: skip
    for own_schema, own_array in lent:  # importing releases them
        pa.RecordBatch._import_from_c(ctypes.addressof(own_array), ctypes.addressof(own_schema))
    if failed:
        raise ValueError(reason.value.decode(errors="replace") or f"it returned {failed}")
    found = pa.RecordBatch._import_from_c(ctypes.addressof(array), ctypes.addressof(schema))
    if found.num_rows != 1:
        raise ValueError(f"it returned {found.num_rows} rows instead of one")
    (row,) = found.to_pylist()
    return {name: None if value is None else float(value) for name, value in row.items()}


def _place(size: int) -> Any:
    return (ctypes.c_uint64 * (size // 8))()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
