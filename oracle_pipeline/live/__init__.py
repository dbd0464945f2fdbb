"""The oracle beside a running robot: it watches, records and judges a DDS domain."""
