"""Run the benchmarks that are named, or all, and print a table of each."""

import argparse

from bench import testbed

BENCHMARKS = {"testbed": testbed.rows}


def main() -> None:
    """Print one line a figure: what, its median, the goal."""
    parser = argparse.ArgumentParser(prog="python -m bench", description=main.__doc__)
    parser.add_argument("names", nargs="*", choices=[*BENCHMARKS, []], help="default: all")
    for name in parser.parse_args().names or BENCHMARKS:
        print(f"\n{name}")
        for row in BENCHMARKS[name]():
            print(f"  {row}", flush=True)


if __name__ == "__main__":
    main()
