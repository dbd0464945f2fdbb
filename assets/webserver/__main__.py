"""``python -m assets.webserver`` is the same as ``oracle-ui``."""

from assets.webserver.server import main

main(prog_name="oracle-ui")
