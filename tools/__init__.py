"""Tools of the developers: benchmarks, tests that take hours, and scripts of the Makefile."""
