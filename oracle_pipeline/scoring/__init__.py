"""Verdicts on recordings, by comparison with the normal runs of a reference (``oracle score``)."""
