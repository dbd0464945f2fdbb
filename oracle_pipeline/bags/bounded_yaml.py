"""Read YAML of unknown origin, within limits on size and depth that its events are checked for."""

from typing import Any

import yaml

from oracle_pipeline.bags.limits import DEEPEST_YAML, LARGEST_YAML, MOST_YAML_VALUES

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def load(text: str) -> Any:
    """Return mappings, lists, numbers and strings.

    Raises
    ------
    ValueError
        If it is no YAML, has an alias or a tag, or is larger or deeper than the limits.
    """
    if len(text) > LARGEST_YAML:
        raise ValueError(f"it is longer than {LARGEST_YAML} characters (LARGEST_YAML)")
    try:
        _check(text)
        return yaml.load(text, Loader=_LOADER)  # noqa: S506 -- a safe loader
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from error


def _check(text: str) -> None:
    depth = values = 0
    for event in yaml.parse(text, Loader=_LOADER):
        if isinstance(event, yaml.AliasEvent):
            raise ValueError("it has an alias, which is not supported")
        if isinstance(event, yaml.ScalarEvent | yaml.CollectionStartEvent):
            if event.tag not in (None, "!"):
                raise ValueError(f"it has a tag, {event.tag}, which is not supported")
            values += 1
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if values > MOST_YAML_VALUES or depth > DEEPEST_YAML:
            raise ValueError(
                f"it has more than {MOST_YAML_VALUES} values or is deeper than {DEEPEST_YAML} "
                "(MOST_YAML_VALUES, DEEPEST_YAML)"
            )
