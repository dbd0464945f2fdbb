"""Measures how well verdicts and scores separate attacked from normal runs, with intervals."""
