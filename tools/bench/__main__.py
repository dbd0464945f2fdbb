"""Run the named benchmarks, or the default ones, and print a table for each."""

import argparse
import gc

from tools.bench import (
    campaign,
    compare,
    engines,
    features,
    harmless,
    inbox,
    instance,
    ladder,
    lengths,
    live,
    magnitudes,
    navigation,
    null_model,
    pull_requests,
    scenarios,
    sensor_faults,
    storage,
    testbed,
)

BENCHMARKS = {
    "testbed": testbed.rows,
    "scenarios": scenarios.rows,
    "navigation": navigation.rows,
    "features": features.rows,
    "compare": compare.rows,
    "harmless": harmless.rows,
    "lengths": lengths.rows,
    "magnitudes": magnitudes.rows,
    "engines": engines.rows,
    "storage": storage.rows,
    "campaign": campaign.rows,
    "inbox": inbox.rows,
    "instance": instance.rows,
    "ladder": ladder.rows,
    "live": live.rows,
    "null_model": null_model.rows,
    "pull_requests": pull_requests.rows,
    "sensor_faults": sensor_faults.rows,
}
DEFAULT = ("testbed", "scenarios")  # speed, size and memory; the others take longer


def main() -> None:
    """Print a line for each figure: its name, its median and its goal."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench", description=main.__doc__)
    parser.add_argument(
        "names", nargs="*", default=DEFAULT, metavar="NAME",
        help=f"of {', '.join(BENCHMARKS)}; default: {', '.join(DEFAULT)}",
    )  # fmt: skip
    names = parser.parse_args().names
    gc.freeze()  # what this module imports is no part of what is measured
    for name in names:
        if name not in BENCHMARKS:
            parser.error(f"there is no benchmark {name!r}; there are {', '.join(BENCHMARKS)}")
    for name in names:
        print(f"\n{name}")
        for row in BENCHMARKS[name]():
            print(f"  {row}", flush=True)


if __name__ == "__main__":
    main()
