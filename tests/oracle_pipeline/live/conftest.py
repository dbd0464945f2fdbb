"""What the tests of the live oracle share."""

from tests.dds_domains import domain, eventually, other_domain

__all__ = ["domain", "eventually", "other_domain"]
