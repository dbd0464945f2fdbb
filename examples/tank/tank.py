"""A tank that loses water: publishes its level, and takes the inflow."""

import random
import time

from number import Number, reader, writer

level, inflow = 0.5, 0.0
told, levels = reader("inflow"), writer("level")
while True:
    for sample in told.take(10):
        inflow = sample.data
    level += 0.05 * (inflow - 0.5 * level)
    levels.write(Number(level + random.gauss(0.0, 0.002)))
    time.sleep(0.05)
