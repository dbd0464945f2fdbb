"""How well verdicts and scores tell attacked runs from right ones, with intervals throughout."""
