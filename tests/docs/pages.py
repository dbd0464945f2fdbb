"""The pages of the docs, and the fenced blocks on them."""

import re
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
DOCS = REPOSITORY / "docs"
README = REPOSITORY / "README.md"
PAGES = sorted([*DOCS.rglob("*.md"), *REPOSITORY.glob("*.md")])

LANGUAGES = {"json", "python", "sh", "text", "toml", "yaml"}  # text: diagrams and output

_BLOCK = re.compile(r"^(?P<indent> *)```(?P<language>\S*)\n(?P<text>.*?)^ *```$", re.M | re.S)
_FILE = re.compile(r"# ([\w./-]+\.(?:py|yaml|toml|json))\n")


@dataclass(frozen=True, slots=True)
class Block:
    """A fenced block."""

    line: int
    language: str
    text: str

    @property
    def file(self) -> str | None:
        """The file that the block is saved as: named by a comment in its first line."""
        named = _FILE.match(self.text)
        return named[1] if named else None


def name(page: Path) -> str:
    return str(page.relative_to(REPOSITORY))


def blocks(page: Path, language: str | None = None) -> list[Block]:
    """Return the blocks of a page, of one language or of all, in their order."""
    text = page.read_text("utf-8")
    everything = [
        Block(
            text.count("\n", 0, found.start()) + 1,
            found["language"],
            re.sub(rf"^{found['indent']}", "", found["text"], flags=re.M),
        )
        for found in _BLOCK.finditer(text)
    ]
    return [block for block in everything if language in (None, block.language)]
