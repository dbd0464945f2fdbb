"""Keeps the level of the tank at a target, as the relay tells it."""

import sys
import time

from number import Number, reader, writer

target = float(sys.argv[1])
levels, inflow = reader("level_relayed"), writer("inflow")
inflow.write(Number(0.0))
while True:
    for sample in levels.take(10):
        inflow.write(Number(max(0.0, 0.5 * target + 2.0 * (target - sample.data))))
    time.sleep(0.02)
