"""Watching a motor while it runs: windows of one second against its model, and when they stop agreeing."""
