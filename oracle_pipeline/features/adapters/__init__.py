"""Other forms of plugins: the thesis's contract."""
