"""Evidence other than logs: tables of readings, judged, fitted and explained by the same candidates as logs are.

A table is rows of measured figures and a way to predict them from a model. The unit of all comparison is the floor of a
figure: what the rounding of the printed number, and the scatter of repeats where it is known, leave of a true model.
"""
