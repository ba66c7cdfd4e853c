"""Estimation on arrays: records, predictions, simulation-error fits and intervals. Knows models, not boards, and
of logs only in ``logs``.
"""
