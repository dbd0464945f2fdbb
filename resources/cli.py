"""``oracle-sim`` with the commands that know what is stored; ``sim`` may not import those."""

from sim.commands.main import main

main.places |= {
    "remake": "resources.storage.commands:remake",
    "storage": "resources.storage.commands:storage",
}
