"""Compares the files of a run with the hashes in its manifest.

``measured.files`` of a manifest holds the SHA-256 of each file of the bag and of each graph. The
manifest itself has a seal (``seals``). A manifest of an older release has no hashes, so the files
of such a run are not checked.
"""

import hashlib
from pathlib import Path

from oracle_pipeline.bags.errors import RunDirectoryError
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import BAG_FOLDER, GRAPHS_FOLDER

PARTS = (BAG_FOLDER, GRAPHS_FOLDER)


def hashes_of_files(run: Path, *parts: str) -> dict[str, str]:
    """Return the SHA-256 of every file in parts of a run directory, by its path in there.

    Parameters
    ----------
    run
        The run directory.
    parts
        ``bag``, ``graphs``; by default both.
    """
    return {
        file.relative_to(run).as_posix(): _sha256(file)
        for part in parts or PARTS
        for file in sorted((run / part).rglob("*"))
        if file.is_file()
    }


def damaged_files(run: Path, manifest: Manifest, *parts: str) -> list[str]:
    """Return the files that are missing, changed or unexpected, by path in the run directory.

    Parameters
    ----------
    run
        The run directory.
    manifest
        Its manifest; without hashes nothing can be compared, and the list is empty.
    parts
        ``bag``, ``graphs``; by default both.
    """
    if not manifest.measured.files:
        return []
    checked = parts or PARTS
    recorded = manifest.measured.files.items()
    expected = {file: digest for file, digest in recorded if file.split("/")[0] in checked}
    found = hashes_of_files(run, *checked)
    return sorted(name for name in expected | found if expected.get(name) != found.get(name))


def require_undamaged(run: Path, manifest: Manifest, *parts: str) -> None:
    """Compare files with their hashes before they are used.

    Raises
    ------
    RunDirectoryError
        Naming the files that are missing, changed or unexpected.
    """
    if damaged := damaged_files(run, manifest, *parts):
        raise RunDirectoryError(
            f"{run} is damaged: {', '.join(damaged)} {'is' if len(damaged) == 1 else 'are'} not "
            f"as recorded. Simulate the run again, with `oracle-sim remake {run}` or by "
            "materializing it with `refresh: true`, or restore the files."
        )


def _sha256(file: Path) -> str:
    with file.open("rb") as source:
        return hashlib.file_digest(source, "sha256").hexdigest()
