"""The manifest of a run: its recipe, its outcome, and the software that made it.

``manifest.json`` is written last, so a directory with one is complete. Its JSON Schema is beside
this module. It has a seal (``seals``) and the hashes of the run's other files. Positions are in the
map frame [m, rad], times in seconds of the recording. Everything but ``measured`` is a function of
the recipe. Labels come from here, never from a name.
"""

import dataclasses
import functools
import json
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self, TypeAlias

from oracle_pipeline.bags import seals
from oracle_pipeline.bags.errors import ManifestError
from oracle_pipeline.bags.protocol import run_key

UNKNOWN_WORLD = "unknown"  # of runs of older releases

SCHEMA_VERSION = 5
# Fields that older versions lack or define differently, with their default values.
_DEFAULTS: dict[str, Any] = {
    "attack_seed": None, "drive": None, "task_effect": None, "world": UNKNOWN_WORLD,
}  # fmt: skip
_ADDED_SINCE = {2: {"changes": [], **_DEFAULTS}, 3: _DEFAULTS, 4: _DEFAULTS}
_SEALED_SINCE = 4
_SEAL = "seal"  # a key of the file; a manifest in memory has none

Label: TypeAlias = Literal["malicious", "normal", "control"]
Outcome: TypeAlias = Literal["succeeded", "aborted", "timeout"]
Kept: TypeAlias = Literal["full", "trimmed", "recipe"]  # how much is kept of a run's bag

LABELS: tuple[Label, ...] = ("malicious", "normal", "control")
KEPT: tuple[Kept, ...] = ("full", "trimmed", "recipe")  # from most to least


@dataclasses.dataclass(frozen=True, slots=True)
class Pose:
    """A pose in the map frame (REP 105)."""

    x: float  # [m]
    y: float  # [m]
    yaw: float  # counter-clockwise from the x axis [rad]


@dataclasses.dataclass(frozen=True, slots=True)
class GoalResult:
    """The result of one goal; a goal that was never sent has none."""

    accepted_s: float
    ended_s: float | None  # None: the run ended first
    outcome: Outcome
    driven_m: float  # distance driven to it
    recoveries: int  # that Nav2 tried on it, costmap clearings included


@dataclasses.dataclass(frozen=True, slots=True)
class Contact:
    """The robot's hull began to touch a piece of the world."""

    stamp_s: float
    piece: str  # name in the world, for example two_two


@dataclasses.dataclass(frozen=True, slots=True)
class Drive:
    """Ground truth on how the robot drove, which no feature sees."""

    clearance_m: float | None  # least distance of its base from any surface; None: no goal was sent
    commands: int  # non-zero velocity commands to the collision monitor
    commands_altered: int  # of these, those that it slowed down or stopped


class Change(NamedTuple):
    """Changes that the mode's node made in one bin of time, from its log."""

    start_s: float  # a multiple of 5 s
    messages: int  # changed, dropped, delayed or fabricated
    largest: float | None  # in the unit of what was changed; None: a number was no longer finite


@dataclasses.dataclass(frozen=True, slots=True)
class TopicCount:
    """The content of the bag for one topic."""

    type: str
    messages: int


@dataclasses.dataclass(frozen=True, slots=True)
class Software:
    """The software that made the run; equal software and recipe give equal messages."""

    code: str  # version of this distribution
    dependencies: str  # digest of the locked dependencies
    cpu: str  # class of the processor, for example x86_64-v3


@dataclasses.dataclass(frozen=True, slots=True)
class Measured:
    """Measurements that differ when the same run is simulated again."""

    wall_s: float
    bytes: Mapping[str, int]  # part of the run directory -> bytes on disk
    kept: Kept = "full"
    freed_bytes: int = 0  # of the bag, to save space
    # SHA-256 of each file of bag and graphs, by path; empty: recorded by an older release
    files: Mapping[str, str] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Manifest:
    """One run, as in ``manifest.json``."""

    mode: str
    label: Label
    run: int
    block: int  # runs of one block share start, goals and nuisance
    session: int
    world: str  # identifies the arena; equal for equal worlds
    seed: int
    start: Pose
    goals: tuple[Pose, ...]
    goal_results: tuple[GoalResult, ...]
    outcome: Outcome  # the worst of the goals'
    onset_s: float | None  # when the attack began; None: never
    attack: Mapping[str, Any]  # all parameters of the scenario; empty without any
    scenario: str
    scenario_hash: str
    # How much more than its control an attacked run has of each quantity in `behaviour`; None: not
    # compared.
    task_effect: Mapping[str, float] | None
    recording_s: float
    contacts: tuple[Contact, ...]
    topics: Mapping[str, TopicCount]
    content_hash: str  # BagWriter.content_hash
    recipe: Mapping[str, Any]  # everything that determines the run
    software: Software
    measured: Measured
    drive: Drive | None = None  # None: not measured, as of a system that does not drive
    changes: tuple[Change, ...] = ()  # bins in which anything was changed
    attack_seed: int | None = None  # seed of the attack's random numbers; None: older release
    schema_version: int = SCHEMA_VERSION

    @property
    def key(self) -> str:
        """``fake_object|run003``, the run's partition key."""
        return run_key(self.mode, self.run)

    def save(self, path: Path) -> None:
        """Write ``manifest.json``.

        Raises
        ------
        ManifestError
            If a value violates the schema; nothing is written then.
        """
        document = {**dataclasses.asdict(self), _SEAL: seals.BLANK}
        try:
            text = json.dumps(document, indent=2, allow_nan=False) + "\n"
        except (TypeError, ValueError) as error:
            raise ManifestError(f"{path} cannot hold this manifest: {error}.") from error
        _validate(json.loads(text), path)
        content = bytearray(text.encode())
        seals.seal(content)
        path.write_bytes(content)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read and check ``manifest.json``.

        Raises
        ------
        ManifestError
            Naming the file and the field, if it is missing, broken, of another schema version,
            invalid by the schema, or was changed after it was written.
        """
        try:
            content = path.read_bytes()
            document = json.loads(content.decode())
        except (OSError, ValueError) as error:
            raise ManifestError(
                f"Could not read {path}: {error}. Record the run again, or restore the file."
            ) from error
        if _is_older(document):
            if document.pop(_SEAL, None) is not None:
                _check_seal(content, path)
            added = _ADDED_SINCE[document["schema_version"]]
            document |= {"schema_version": SCHEMA_VERSION, **added}
            _validate(document | {_SEAL: seals.BLANK}, path)
        else:
            _validate(document, path)
            _check_seal(content, path)
            del document[_SEAL]
        return cls(
            **{
                **document,
                "start": Pose(**document["start"]),
                "goals": tuple(Pose(**goal) for goal in document["goals"]),
                "goal_results": tuple(GoalResult(**goal) for goal in document["goal_results"]),
                "contacts": tuple(Contact(**contact) for contact in document["contacts"]),
                "drive": document["drive"] and Drive(**document["drive"]),
                "changes": tuple(Change(*change) for change in document["changes"]),
                "topics": {name: TopicCount(**topic) for name, topic in document["topics"].items()},
                "software": Software(**document["software"]),
                "measured": Measured(**document["measured"]),
            }
        )


@functools.cache
def schema() -> dict[str, Any]:
    """Return the JSON Schema of ``manifest.json``."""
    text = files(__package__).joinpath("manifest.schema.json").read_text("utf-8")
    document: dict[str, Any] = json.loads(text)
    return document


def _is_older(document: Any) -> bool:
    """Return whether this is a manifest of an older version, the oldest of which had no seals."""
    if not isinstance(document, dict) or document.get("schema_version") not in _ADDED_SINCE:
        return False
    return bool((_SEAL in document) == (document["schema_version"] >= _SEALED_SINCE))


def _check_seal(content: bytes, path: Path) -> None:
    if seals.check(content) != "right":
        raise ManifestError(
            f"{path} was changed after it was written: its content and its seal differ. Restore "
            "it, or record the run again."
        )


def _validate(document: Any, path: Path) -> None:
    version = document.get("schema_version") if isinstance(document, dict) else None
    if isinstance(version, int) and version != SCHEMA_VERSION:
        raise ManifestError(
            f"{path} has schema version {version}, this release reads {SCHEMA_VERSION}; "
            "install the release that wrote it, or record the run again."
        )
    import jsonschema  # its import takes longer than `oracle --help` may

    from oracle_pipeline.bags.json_schema import faults

    error = jsonschema.exceptions.best_match(faults(document, schema()))
    if error is not None:
        field = ".".join(str(part) for part in error.absolute_path) or "(top level)"
        raise ManifestError(f"{path}, field {field}: {error.message}. Record the run again.")
