"""Signals: every number of every message, as series in time, and their statistics.

A robot that the built-in features do not know still has signals.
"""
