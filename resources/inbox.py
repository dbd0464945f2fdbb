"""The folder for recordings from other sources, and the reference card to judge them with."""

import os
from pathlib import Path

import dagster as dg
from pydantic import Field

from oracle_pipeline.bags.errors import OracleError

INBOX, CARD = "ORACLE_INBOX", "ORACLE_CARD"


class InboxError(OracleError):
    """The folder or the card is not configured, or does not exist."""


class Inbox(dg.ConfigurableResource[None]):
    """The inbox folder and the card. With empty settings, nothing is judged."""

    # Not part of the run config: a run request must not choose what this process reads.
    folder: dg.ResourceDependency[str] = Field(
        default="",  # type: ignore[arg-type]  # Dagster makes a dependency of it
        description="Folder that recordings are dropped into.",
    )
    card: dg.ResourceDependency[str] = Field(
        default="",  # type: ignore[arg-type]
        description="Reference card that `oracle learn` wrote.",
    )

    @classmethod
    def from_environment(cls) -> "Inbox":
        """Return the inbox that ``ORACLE_INBOX`` and ``ORACLE_CARD`` configure."""
        return cls(folder=os.environ.get(INBOX, ""), card=os.environ.get(CARD, ""))

    @property
    def path(self) -> Path:
        """The folder.

        Raises
        ------
        InboxError
            It is not configured, or does not exist.
        """
        if not self.folder:
            raise InboxError(f"No inbox is configured: set {INBOX} to a folder, and reload.")
        folder = Path(self.folder).expanduser().resolve()
        if not folder.is_dir():
            raise InboxError(f"There is no folder {folder}; create it, or correct {INBOX}.")
        return folder

    @property
    def card_path(self) -> Path:
        """The reference card.

        Raises
        ------
        InboxError
            It is not configured, or does not exist.
        """
        if not self.card:
            raise InboxError(
                f"No reference card is configured: write one with `oracle learn`, set {CARD} to "
                "it, and reload."
            )
        card = Path(self.card).expanduser().resolve()
        if not card.is_file():
            raise InboxError(f"There is no reference card {card}; create it with `oracle learn`.")
        return card
