"""``python -m resources.ui`` is the same as ``oracle-ui``."""

from resources.ui.server import main

main(prog_name="oracle-ui")
