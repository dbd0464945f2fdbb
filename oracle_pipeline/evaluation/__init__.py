"""How well verdicts and scores tell attacked runs from normal ones, with intervals throughout."""
