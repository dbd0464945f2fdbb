"""JSON Schemas as they are meant: ``$`` is the end of the text, as in ECMA 262.

To Python ``$`` is also the place before a last line feed, so that ``fake_object`` and a line feed
would pass for a name, and become the name of a folder or of a partition.
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
    """Return all that is wrong with a document, nothing if it is as its schema says."""
    return list(_Validator(schema).iter_errors(document))
