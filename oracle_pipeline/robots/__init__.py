"""The robots of a recording, and the roles of their topics."""
