"""Search for attacks: parameters are proposed, run in closed loop, and judged by a card."""
