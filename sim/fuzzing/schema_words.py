"""The JSON Schema of a scenario, and its errors as text."""

import difflib
import functools
import json
from collections.abc import Iterator, Sequence
from importlib.resources import files
from typing import Any, cast

import jsonschema


@functools.cache
def schema() -> dict[str, Any]:
    """Return the JSON Schema of a scenario."""
    text = files(__package__).joinpath("scenario.schema.json").read_text("utf-8")
    document: dict[str, Any] = json.loads(text)
    return document


def in_words(error: jsonschema.ValidationError) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Yield the place of each error, and the expected value."""
    key: tuple[str | int, ...] = tuple(error.absolute_path)
    rule, value = error.validator, cast(Any, error.validator_value)
    instance, rules = cast(Any, error.instance), cast(dict[str, Any], error.schema)
    found = f"found {_shown(instance)}"
    match rule:
        case "type":
            kinds = [value] if isinstance(value, str) else value
            yield key, f"expected {' or '.join(_KINDS[kind] for kind in kinds)}, {found}"
        case "const":
            yield key, f"expected {value}, {found}"
        case "enum":
            yield key, f"expected one of {', '.join(value)}, {found}{_meant(instance, value)}"
        case "required":
            yield from ((key, f"expected the key {n}") for n in value if n not in instance)
        case "additionalProperties":
            known = list(rules.get("properties", ()))
            there = f"expected one of {', '.join(known)}" if known else "expected nothing"
            for unknown in (name for name in instance if name not in known):
                hint = _meant(unknown, known) or _unquoted(instance[unknown])
                text = f"{there}, found {_shown(unknown)}{hint}"
                yield (*key, unknown), text
        case "pattern":
            yield key, f"expected {_PATTERNS[value]}, {found}"
        case "minProperties" | "minItems" | "minLength" | "minimum":
            yield key, f"expected at least {value}, {found}"
        case "maxProperties" | "maxItems" | "maxLength":
            yield key, f"expected at most {value}, found {len(instance)}"
        case "uniqueItems":
            yield key, f"expected each value once, {found}"
        case "exclusiveMinimum":
            yield key, f"expected more than {value}, {found}"
        case "maximum":
            yield key, f"expected at most {value}, {found}"
        case "oneOf" | "anyOf":
            kinds = [_KINDS[kind] for each in value for kind in _types(each)]
            yield key, f"expected {' or '.join(kinds) or 'another value'}, {found}"
        case _:
            yield key, f"not valid: {error.message[:200]}"


_KINDS = {
    "object": "a mapping",
    "array": "a list",
    "string": "a text",
    "number": "a number",
    "integer": "a whole number",
    "boolean": "true or false",
}

_PATTERNS = {
    schema()["$defs"][name]["pattern"]: words
    for name, words in {
        "name": "a name such as random_noise",
        "topic": "a full topic name such as /scan_tom",
        "node": "a full node name such as /controller_server",
        "message_type": "a message type such as sensor_msgs/msg/LaserScan",
        "field": "a field such as pose.pose.position.x",
    }.items()
}


def _types(rules: dict[str, Any]) -> list[str]:
    """Return the types that a rule allows, if it lists them directly."""
    types = rules.get("type", [])
    return [types] if isinstance(types, str) else types


def _meant(found: Any, known: Sequence[Any]) -> str:
    """Return a question that names the most similar known word, if one is similar."""
    near = difflib.get_close_matches(str(found), [str(word) for word in known], n=1)
    return f" (did you mean {near[0]}?)" if near else ""


def _unquoted(value: Any) -> str:
    """Return a hint if YAML reads a part of an expression as a key without a value."""
    return " (an expression with a comma needs quotes)" if value is None else ""


def _shown(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
