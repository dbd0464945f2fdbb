"""Tests that take hours: campaigns that are killed many times, full disks, small budgets."""
