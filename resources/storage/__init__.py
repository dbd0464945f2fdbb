"""What is kept on disk and what is dropped. Only the commands know a terminal."""
