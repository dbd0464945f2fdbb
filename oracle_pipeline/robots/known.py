"""The topics that a reference knows, and which of them plays each role.

Features of a recording come from these topics, so a topic that is new takes no role of a missing
one. A roles file says which topic took its place.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.robots.roles import ROLES, Roles, find_roles

Chosen: TypeAlias = Mapping[str, tuple[str, ...]]  # topics by role, from a roles file


@dataclass(frozen=True, slots=True)
class Known:
    """Topics of the normal recordings of a reference.

    Attributes
    ----------
    topics : frozenset of str
    roles : mapping of str to tuple of str
        Topics that play each role.
    """

    topics: frozenset[str]
    roles: Mapping[str, tuple[str, ...]]

    def renamed(self, bag: BagReader, chosen: Chosen) -> tuple[BagReader, Chosen]:
        """Return a bag and its roles file with the reference's names.

        If the topic of a role is absent, the new one that the roles file names gets its name.
        """
        shown = {given: name for name in bag.topics for given in (bag.recorded(name), name)}
        names = {name: name for name in bag.topics}
        for role, topics in chosen.items():
            absent = [name for name in self.roles.get(role, ()) if name not in bag.topics]
            new = [shown[given] for given in topics if shown.get(given, given) in self._new(bag)]
            if absent and len(new) == 1 and (len(absent) == 1 or not ROLES[role].several):
                names[new[0]] = absent[0]
        translated = {
            role: tuple(names[shown[given]] if given in shown else given for given in topics)
            for role, topics in chosen.items()
        }
        return bag.renamed(names), translated

    def roles_in(self, bag: BagReader, chosen: Chosen) -> Roles:
        """Return the roles of a recording: as a roles file has them, or as in the reference."""
        return find_roles(bag, {role: self._present(role, bag) for role in ROLES} | dict(chosen))

    def instead(self, bag: BagReader, chosen: Chosen) -> dict[str, tuple[str, ...]]:
        """Return the topics that may play a role of which topics are absent, new ones among them.

        Roles of the roles file are left out.
        """
        absent = [
            role
            for role in ROLES
            if role not in chosen and not bag.topics.keys() >= {*self.roles.get(role, ())}
        ]
        new = {name: name for name in self._new(bag)}
        if not absent or not new:
            return {}
        others = find_roles(bag.renamed(new)).found
        return {
            role: (*self._present(role, bag), *others[role].topics)
            for role in absent
            if others[role].topics and (ROLES[role].several or not self._present(role, bag))
        }

    def _new(self, bag: BagReader) -> list[str]:
        return [name for name in bag.topics if name not in self.topics]

    def _present(self, role: str, bag: BagReader) -> tuple[str, ...]:
        of_role = ROLES[role]
        topics = [
            name
            for name in self.roles.get(role, ())
            if name in bag.topics and bag.topics[name].msgtype in of_role.types
        ]
        return tuple(topics if of_role.several else topics[:1])
