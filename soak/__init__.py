"""What takes hours to show: campaigns that are killed again and again, and tight budgets."""
