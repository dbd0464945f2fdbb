#!/usr/bin/env bash
# try_commands.sh BIN [--quick]: the commands of the README, timed, with the programs in a folder.
# They run in an empty folder, so that only what is installed can help them. --quick leaves out those
# that need runs: recording the first one compiles the simulator, which takes most of a minute.
set -euo pipefail
export PATH="$(cd "$1" && pwd):$PATH"
cd "$(mktemp -d)"
export DAGSTER_HOME="$PWD" TIMEFORMAT="  %1R s, of the processor %1U s"
trap 'rm -rf "$DAGSTER_HOME"' EXIT

run() { # EXPECTED COMMAND...: run it, and end if it does not exit as expected
  local expected=$1 found=0
  shift
  echo "$*"
  time { "$@" >log 2>&1 || found=$?; }
  if [ "$found" != "$expected" ]; then
    cat log
    echo "Expected exit code $expected, found $found." >&2
    exit 1
  fi
}

run 0 oracle --version
run 0 oracle-sim scenario list
run 0 oracle-sim scenario show random_noise
run 0 dagster definitions validate -m oracle_pipeline.definitions
if [ "${2:-}" = --quick ]; then exit; fi
run 0 oracle-sim record -m lidar_passthrough -n 6 --goals 1
run 0 oracle learn data/runs/lidar_passthrough --output robot.card
run 0 oracle-sim mutate data/runs/lidar_passthrough/run005/bag attacked_bag random_noise --at 5
run 1 oracle score attacked_bag --reference robot.card --far 0.25 --page verdict.html
run 0 oracle replay attacked_bag
