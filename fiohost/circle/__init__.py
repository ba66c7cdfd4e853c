"""The closed circle: logs to evidence, a plan of experiments, a bench, the diagnosis, a fresh record to confirm it."""
