"""The scenario language, which alters the messages of a topic in a testbed or in a bag."""
