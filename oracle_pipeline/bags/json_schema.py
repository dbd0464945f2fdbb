"""Validation by JSON Schema with ``$`` as the end of the text, as in ECMA 262.

In Python, ``$`` also matches before a final line feed. So ``fake_object`` followed by a line feed
would pass as a name, and become the name of a folder or a partition.
"""

import re
from collections.abc import Iterator, Mapping
from typing import Any

import jsonschema


def _whole_pattern(
    _validator: Any, pattern: str, instance: Any, _schema: Any
) -> Iterator[jsonschema.ValidationError]:
    if isinstance(instance, str) and not re.search(pattern.replace("$", r"\Z"), instance):
        yield jsonschema.ValidationError(f"{instance!r} does not match {pattern!r}")


_Validator: Any = jsonschema.validators.extend(  # type: ignore[no-untyped-call]
    jsonschema.Draft202012Validator, {"pattern": _whole_pattern}
)


def faults(document: Any, schema: Mapping[str, Any]) -> list[jsonschema.ValidationError]:
    """Return all faults of a document by its schema."""
    return list(_Validator(schema).iter_errors(document))
