"""``python -m resources.ui``: what ``oracle-ui`` does."""

from resources.ui.server import main

main(prog_name="oracle-ui")
