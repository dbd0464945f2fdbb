"""The thesis's plugin contract: ``extract_features(self, G, cur)``.

``G`` is the graph of the whole run, ``cur`` an ``sqlite3`` cursor over the bag's messages with the
tables of rosbag2 (``topics``, ``messages``), whatever the bag's format; ground truth is never in
it. A plugin returns a list of numbers, which become columns ``thesis.<file>_0``, ``_1``, ...
"""

import sqlite3
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from oracle_pipeline.bags.graph_files import RosGraph
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.features.adapters.ros_stand_ins import stand_ins
from oracle_pipeline.features.engine.plugin import Feature
from oracle_pipeline.graphs.views import thesis_view

# rosbag2's schema of Humble, where these plugins come from.
_SCHEMA = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
  serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
  timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""


class FeatureExtractionPlugin(ABC):
    """Base of plugins in the thesis's form; ``from plugin_interface import`` finds it too."""

    @abstractmethod
    def extract_features(self, G: RosGraph, cur: sqlite3.Cursor) -> list[float]:
        """Return the features of a run, always the same number and order."""


@dataclass(frozen=True, slots=True)
class ThesisPlugin:
    """One plugin in the thesis's form, with its file."""

    name: str
    plugin: FeatureExtractionPlugin

    def extract(self, graph: RosGraph, cursor: sqlite3.Cursor) -> list[float]:
        """Call the plugin.

        Raises
        ------
        ValueError
            If what it returns is not a list of numbers, or is empty.
        """
        with stand_ins():
            values = self.plugin.extract_features(thesis_view(graph), cursor)
        numbers = [float(value) for value in values]
        if not numbers:
            raise ValueError("it returned no numbers")
        return numbers

    @property
    def column(self) -> str:
        """Prefix of its columns' names."""
        return f"thesis.{self.name}"

    def feature(self, index: int) -> Feature:
        """Describe a column; the contract has no units."""
        return Feature(f"{self.name}_{index}", "", 0.0, f"number {index} of plugin {self.name}")


class MessageTable:
    """The messages of a bag as a temporary SQLite database, which SQLite moves to disk if large."""

    def __init__(self, bag: BagReader) -> None:
        self._database = sqlite3.connect("")
        self._database.executescript(_SCHEMA)
        topic_ids = {name: number for number, name in enumerate(bag.topics, start=1)}
        self._database.executemany(
            "INSERT INTO topics VALUES (?, ?, ?, ?, '')",
            [
                (number, name, bag.topics[name].msgtype, bag.serialization)
                for name, number in topic_ids.items()
            ],
        )
        self._database.executemany(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
            ((topic_ids[topic], stamp_ns, data) for topic, stamp_ns, data in bag.messages()),
        )

    @contextmanager
    def cursor(self) -> Iterator[sqlite3.Cursor]:
        """Yield a read-only cursor."""
        self._database.commit()
        self._database.execute("PRAGMA query_only = ON")
        cursor = self._database.cursor()
        try:
            yield cursor
        finally:
            cursor.close()

    def close(self) -> None:
        """Delete the database."""
        self._database.close()
