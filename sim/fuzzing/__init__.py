"""The scenario language: what is done to the messages of a topic, in a testbed or over a bag."""
