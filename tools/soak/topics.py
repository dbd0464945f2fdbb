"""Watch a robot that opens a thousand topics.

``python -m tools.soak.topics`` starts `oracle watch`, and then another process that opens 1,000
topics on its domain and sends a message on each every second. It prints how long it takes until
each topic has a message in the recording, what of it the watch and the other process use, and what
the finished recording holds. It exits with 1 if a topic is missing, or has no publisher in the
graph.
"""

import argparse
import json
import multiprocessing
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.dds_names import dds_topic
from oracle_pipeline.bags.run_directory import RECORDING_FILE
from oracle_pipeline.bags.types import message_class, serialize
from oracle_pipeline.opened_run import open_run
from sim.middleware.qos import DEFAULT
from tools.bench.side_by_side import memory_bytes, processor_s
from tools.soak.watch import DOMAIN

TOPICS = 1000
MOST_S = 600.0  # until all are recorded
AFTER_S = 30.0  # that it goes on then
_TEXT = "std_msgs/msg/String"


def _send(domain: int, topics: int) -> None:
    participant, text = dds.join(domain), serialize(message_class(_TEXT)("hello"), _TEXT)
    names = [dds_topic(f"/topic{number}") for number in range(topics)]
    writers = [dds.RawWriter(participant, name, _TEXT, DEFAULT) for name in names]
    while True:
        for writer in writers:
            writer.write(text)
        time.sleep(1.0)


def _recorded(folder: Path) -> int:
    """Return how many topics have messages so far, by the summary of the recording."""
    counts = [
        json.loads(path.read_text())["messages"] for path in folder.glob(f"*/{RECORDING_FILE}")
    ]
    return sum(count > 0 for of in counts for count in of.values())


def main() -> None:
    """Print time, memory and topics."""
    parser = argparse.ArgumentParser(prog="python -m tools.soak.topics", description=main.__doc__)
    parser.add_argument("--topics", type=int, default=TOPICS)
    parser.add_argument("--domain", type=int, default=DOMAIN)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder, oracle = Path(place), Path(sys.executable).parent / "oracle"
        watch = subprocess.Popen(
            [oracle, "watch", "--domain", str(options.domain), "--out", folder]
        )
        sender = multiprocessing.get_context("spawn").Process(
            target=_send, args=(options.domain, options.topics), daemon=True
        )
        sender.start()
        began = time.monotonic()
        while _recorded(folder) < options.topics and time.monotonic() - began < MOST_S:
            time.sleep(1.0)
        found_s, found_mb = time.monotonic() - began, memory_bytes(watch.pid) / 1e6
        time.sleep(AFTER_S)
        memory_mb, used_s = memory_bytes(watch.pid) / 1e6, processor_s(watch.pid)
        watch.send_signal(signal.SIGINT)
        watch.wait()
        sender.kill()
        (path,) = folder.iterdir()
        with open_run(path, strict=True) as run:
            counts = [topic.count for topic in run.bag.topics.values()]
            topics = {name for name in run.intervals[-1].graph if name.startswith("topic:")}
    print(f"All were recorded after {found_s:.0f} s; {min(counts)} to {max(counts)} messages each.")
    print(f"Memory: {found_mb:.0f} MB then, {memory_mb:.0f} MB {AFTER_S:.0f} s later.")
    print(f"Processor time of the watch: {used_s:.0f} s.")
    print(f"{len(counts)} topics in the bag, {len(topics)} in the last graph.")
    sys.exit(not len(counts) == len(topics) == options.topics)


if __name__ == "__main__":
    main()
