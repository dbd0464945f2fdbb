"""Checks of a single recording that need no reference: faults of sensors, clocks and transport.

Each check is a function of one topic (`times`, `values`), named in the table of `run`.
"""
