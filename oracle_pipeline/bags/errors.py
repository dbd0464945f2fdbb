"""The base classes of all errors that this distribution raises on purpose."""


class OracleError(Exception):
    """Root of the tree; its message states what is wrong, where, and what to do next."""


class BagError(OracleError):
    """A bag cannot be written, opened, read or decoded."""


class ManifestError(OracleError):
    """A ``manifest.json`` is missing, unreadable or not valid by its schema."""


class RunDirectoryError(OracleError):
    """A run directory has a bad name, or is not complete."""


class GraphError(OracleError):
    """A GEXF or GraphML file is unreadable or not one of ours."""


class DdsError(OracleError):
    """A DDS domain cannot be joined, or a topic there cannot be read or published."""
