"""Signals: every number of every message, as series in time, and their statistics.

Robots that nobody here knows have no features of their own. Their signals have.
"""
