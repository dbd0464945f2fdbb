"""``oracle-sim`` with the commands that know more than ``sim``: what is stored, and verdicts."""

from sim.commands.main import main

main.places |= {
    "search": "resources.search.commands:search",
    "remake": "resources.storage.commands:remake",
    "storage": "resources.storage.commands:storage",
}
