"""The roles file: a small YAML for robots and topics that cannot be found by message type.

::

    robots: [/robot1, /robot2]     # namespaces; / is the whole recording as one robot
    roles:
      odometry: /wheel/odometry    # a topic's name as recorded, or without the namespace
      scan: [/front/scan, /rear/scan]
      pose: []                     # this robot has none
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from oracle_pipeline.bags import bounded_yaml
from oracle_pipeline.robots.roles import ROLES, RolesError

_LARGEST = 64 * 1024  # bytes


@dataclass(frozen=True, slots=True)
class RoleChoices:
    """The content of a roles file.

    Attributes
    ----------
    robots : tuple of str or None
        Namespaces without the trailing slash; the root is empty. None: they are detected.
    topics : mapping of str to tuple of str
        Topics by role.
    """

    robots: tuple[str, ...] | None = None
    topics: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a roles file.

        Raises
        ------
        RolesError
            The file is invalid; the message has the fault.
        """
        with path.open("rb") as source:
            content = source.read(_LARGEST + 1)
        try:
            if len(content) > _LARGEST:
                raise ValueError(f"it is larger than {_LARGEST} bytes")
            return cls.of(bounded_yaml.load(content.decode()))
        except (ValueError, UnicodeDecodeError) as error:
            raise RolesError(
                f"{path} is not a roles file: {error}. See docs/how-to/other-robots.md."
            ) from error

    @classmethod
    def of(cls, document: Any) -> Self:
        """Return the choices from the content of a roles file.

        Raises
        ------
        ValueError
            The content is invalid.
        """
        document = _mapping("the file", document, ("robots", "roles"))
        topics = _mapping("roles", document.get("roles") or {}, tuple(ROLES))
        names = {role: _names(role, given) for role, given in topics.items()}
        for role, given in names.items():
            if len(given) > 1 and not ROLES[role].several:
                raise ValueError(f"a robot has one {role}, found {', '.join(given)}")
        robots = document.get("robots")
        return cls(
            None if robots is None else tuple(n.rstrip("/") for n in _names("robots", robots)),
            names,
        )

    def document(self) -> dict[str, Any]:
        """Return the content of an equivalent roles file."""
        robots = [] if self.robots is None else [f"{name}/" for name in self.robots]
        roles = {role: list(names) for role, names in self.topics.items()}
        return {"roles": roles} if self.robots is None else {"robots": robots, "roles": roles}


def _mapping(what: str, given: Any, known: tuple[str, ...]) -> dict[str, Any]:
    if not isinstance(given, dict):
        raise ValueError(f"{what} must be a mapping of {', '.join(known)}")
    if unknown := [str(key) for key in given if key not in known]:
        raise ValueError(f"{what} has {', '.join(unknown)}; known are {', '.join(known)}")
    return given


def _names(key: str, given: Any) -> tuple[str, ...]:
    names = given if isinstance(given, list) else [given]
    for name in names:
        if not isinstance(name, str) or not name.startswith("/"):
            raise ValueError(f"{key} must be names that begin with a slash, found {name!r}")
    return tuple(names)
