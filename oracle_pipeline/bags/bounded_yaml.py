"""Read YAML of unknown origin by events, within limits on size and depth."""

from typing import Any

import yaml

from oracle_pipeline.bags.limits import DEEPEST_YAML, LARGEST_YAML, MOST_YAML_VALUES

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _Text(yaml.SafeLoader):
    """Only for its rules on plain scalars: number, boolean or string."""

    def __init__(self) -> None:
        super().__init__("")


def load(text: str) -> Any:
    """Return mappings, lists, numbers and strings.

    Raises
    ------
    ValueError
        If it is no YAML, has an alias or a tag, or is larger or deeper than the limits.
    """
    if len(text) > LARGEST_YAML:
        raise ValueError(f"it is longer than {LARGEST_YAML} characters (LARGEST_YAML)")
    scalars = _Text()
    stack: list[Any] = []
    keys: list[Any] = []  # of the mapping at each depth: the key that waits for its value
    document: Any = None
    values = 0
    nothing = object()
    try:
        for event in yaml.parse(text, Loader=_LOADER):
            if isinstance(event, yaml.AliasEvent):
                raise ValueError("it has an alias, which is not supported")
            if isinstance(event, yaml.MappingStartEvent | yaml.SequenceStartEvent):
                _refuse_tag(event.tag)
                value: Any = {} if isinstance(event, yaml.MappingStartEvent) else []
            elif isinstance(event, yaml.ScalarEvent):
                value = _scalar(scalars, event)
            elif isinstance(event, yaml.MappingEndEvent | yaml.SequenceEndEvent):
                stack.pop()
                keys.pop()
                continue
            else:
                continue
            values += 1
            if values > MOST_YAML_VALUES or len(stack) > DEEPEST_YAML:
                raise ValueError(
                    f"it has more than {MOST_YAML_VALUES} values or is deeper than {DEEPEST_YAML} "
                    "(MOST_YAML_VALUES, DEEPEST_YAML)"
                )
            if not stack:
                document = value
            elif isinstance(stack[-1], list):
                stack[-1].append(value)
            elif keys[-1] is nothing:
                if isinstance(value, dict | list):
                    raise ValueError("a key is a mapping or a list")
                keys[-1] = value
            else:
                stack[-1][keys[-1]] = value
                keys[-1] = nothing
            if isinstance(value, dict | list):
                stack.append(value)
                keys.append(nothing)
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from error
    return document


def _refuse_tag(tag: str | None) -> None:
    if tag not in (None, "!"):
        raise ValueError(f"it has a tag, {tag}, which is not supported")


def _scalar(rules: _Text, event: yaml.ScalarEvent) -> Any:
    _refuse_tag(event.tag)
    if not event.implicit[0]:
        return event.value
    tag = rules.resolve(yaml.ScalarNode, event.value, (True, False))  # type: ignore[no-untyped-call]
    return rules.construct_object(yaml.ScalarNode(tag, event.value))
