"""Sealed manifests whose content differs from the recording."""

import json
from collections.abc import Callable
from typing import Any

from oracle_pipeline.bags import seals
from oracle_pipeline.bags.run_directory import RunDirectory


def rewrite(run: RunDirectory, change: Callable[[dict[str, Any]], object]) -> None:
    """Change the manifest of a run as its own software could have written it."""
    document = json.loads(run.manifest_path.read_bytes())
    change(document)
    content = bytearray(json.dumps({**document, "seal": seals.BLANK}).encode())
    seals.seal(content)
    run.manifest_path.write_bytes(content)
