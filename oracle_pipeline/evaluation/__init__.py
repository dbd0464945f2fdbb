"""How well verdicts and scores separate attacked from normal runs, always with intervals."""
