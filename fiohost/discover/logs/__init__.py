"""Logs as evidence: whole runs, one-second windows as they are, and windows weighed by the noise that is left."""
