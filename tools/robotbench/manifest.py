"""The files that the published figures are of, to compare with a download."""

import hashlib
from pathlib import Path
from typing import NamedTuple


class Files(NamedTuple):
    """The files of a set that are read."""

    patterns: tuple[str, ...]  # below the folder of the set
    number: int
    sha256: str  # of their paths and contents, in the order of paths


#: By folder.
MANIFEST = {
    "crazyflie": Files(("labels.csv", "*.parquet"), 127,
        "60f7254d17b529d6a92138cc55ac5b0a48ef2ebc000baefddbc6a14a4ad0d0d8"),
    "uci_arm": Files(("*.data",), 4,
        "3812a46342dc0f4b7000a61cbbf0dac149690a82bda9205dbd21a80bec17db9a"),
    "arm": Files(("2*/*.csv",), 138,
        "b9ca896c4dd98780f695808d5d040d9051bdfcd73a5f70cac8e5cac2a0af52d6"),
    "kairos": Files(("*_plan*/*.csv",), 16,
        "fd91c22173885746df42c75363d251342b29cc3cf5ed0bd41a17a496367e401c"),
    "humanoid": Files(("meta/*", "data/*/*.parquet"), 104,
        "3bd0f93ce07f4a6a0cdab479e463d9f0d3b5196d8121d0cc6e1da175c37a4768"),
    "jackal": Files(("*/*/*.json",), 299,
        "83ad4c4fd75da5ef811ddf2f5851a7c17b1a4e52560de18469b1a6acd0b07c1a"),
    "quadcopter": Files(("Hover/*/*.BIN", "Straight line/*/*.BIN"), 30,
        "2d6836eba72525d5d65b9d7b5d75d5c5564fe5634ca52b957023b07fea653e7a"),
    "alfa": Files(("*/carbonZ_*.csv",), 45,
        "7ebbf089eafd57cace82e441fb5126cee481cb6919e2a576eae7f0f40866c2cb"),
    "auv": Files(("*/*/*.csv",), 1_225,
        "f373416e4c5df9901f8fcccfe459ba0088118341a9b652b1a9329bac58a2f540"),
    "shaft": Files(("M*Mode/*.csv",), 149,
        "0e856cc1b67ae19163906c2726f9cfcf80bfbda271459a4830175e97656cda56"),
}  # fmt: skip


def compared(folder: Path, files: Files) -> tuple[int, str]:
    """Return the number of files of a set, and how they differ from those of the figures."""
    count, sha256 = _digest(folder, files.patterns)
    if not count:
        return 0, f"{folder} has no file of the set ({', '.join(files.patterns)}); it is left out."
    if sha256 == files.sha256:
        return count, ""
    known = f"{files.number:,} files with SHA-256 {files.sha256[:12]}"
    here = f"here are {count:,}, with {sha256[:12]}"
    return count, f"{folder}: the published figures are of {known}; {here}."


def _digest(folder: Path, patterns: tuple[str, ...]) -> tuple[int, str]:
    """Return number and SHA-256 of the files in a folder that have one of the patterns."""
    paths = sorted({path for pattern in patterns for path in folder.glob(pattern)})
    whole = hashlib.sha256()
    for path in paths:
        own = hashlib.sha256(path.read_bytes()).hexdigest()
        whole.update(f"{own}  {path.relative_to(folder).as_posix()}\n".encode())
    return len(paths), whole.hexdigest()
