"""Other forms of plugins: shared libraries, and the thesis's contract."""
