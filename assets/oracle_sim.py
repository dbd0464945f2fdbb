"""``oracle-sim`` with the commands that need more than ``sim``: storage and search."""

from sim.commands.main import main

main.places |= {
    "search": "assets.search.commands:search",
    "remake": "resources.storage.commands:remake",
    "storage": "resources.storage.commands:storage",
}
