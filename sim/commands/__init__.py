"""``oracle-sim``: what a person types. No run depends on this folder."""
