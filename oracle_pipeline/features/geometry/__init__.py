"""Poses, laser scans and points in the plane, and positions on the Earth."""
