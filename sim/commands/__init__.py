"""The commands of ``oracle-sim``. No run depends on this folder."""
