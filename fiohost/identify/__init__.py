"""Estimation on arrays: records, predictions, simulation-error fits and intervals. Knows models, not logs or boards."""
