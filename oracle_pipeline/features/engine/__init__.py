"""What computes features from a bag: the plugin interface, one pass over the messages, tables."""
